"""Snapshots: files of single maps, made at one revision while the service works, and kept."""

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

import sqlalchemy as sa

from schemas.errors import BadSnapshot, NotFound
from schemas.recipe import DescriptionRecipe
from schemas.removal import Holding
from schemas.snapshot import SnapshotFacts, SnapshotRecord
from worker.storage.database import Database
from worker.storage.disk_errors import translated
from worker.storage.image_store import ImageStore, needs_image
from worker.storage.part import Part
from worker.storage.rows import find_map, find_recipe, log, map_record
from worker.storage.snapshot_contents import SnapshotContents
from worker.storage.snapshot_files import COMPARISONS, VOCABULARY, SnapshotWriter
from worker.storage.snapshot_places import WRITING, SnapshotPlace, drop_drafts
from worker.storage.snapshot_portions import Portions, SizedView
from worker.storage.snapshot_rows import comparison_lines
from worker.storage.tables import CELLS, JOBS, VIEWS as VIEW_ROWS, VOCABULARIES
from worker.storage.uncached_file import UncachedFile

SAMPLE = 32
"""Descriptions from whose sizes that of all is estimated."""

COMPARISON_PORTION = 2000

RECEIVING = ".receiving-"

_ID = re.compile("[0-9a-f-]{36}")


class Snapshots(Part, retried=False):
    """Files of snapshots, named by the job that made each.

    Parameters
    ----------
    database : Database
    images : ImageStore
    folder : Path
        Where those are received that are to be restored; made with the first of them.
    place : SnapshotPlace
        Where those are kept that are made.
    """

    def __init__(self, database: Database, images: ImageStore, folder: Path, place: SnapshotPlace) -> None:
        super().__init__(database, images)
        self._folder, self._place = folder, place
        self._contents = SnapshotContents(place)

    # made

    def make(
        self, name: str, snapshot_id: str, now: datetime, on_progress: Callable[[int, int], None]
    ) -> SnapshotRecord:
        """Write the snapshot of a map, as it is when this begins; what it had under this id is replaced.

        A view that is deleted meanwhile may be left out.

        Parameters
        ----------
        name : str
        snapshot_id : str
        now : datetime
        on_progress : function
            Called with the number of views done and of all; what it raises ends the work and removes the file.

        Raises
        ------
        NotFound, DiskFull
        Damaged
            A row or an image that nothing can replace is damaged.
        """
        with translated("snapshots"), self._place.draft(snapshot_id) as draft:
            with UncachedFile(draft) as file, self._database.reading() as connection:
                views = self._write(connection, file, name, snapshot_id, now, on_progress)
            on_progress(views, views)  # who lost the job meanwhile keeps nothing: another may have made it by now
            self._place.keep(draft, snapshot_id, lambda: on_progress(views, views))
        return self.get(snapshot_id)

    def _write(
        self,
        connection: sa.Connection,
        file: UncachedFile,
        name: str,
        snapshot_id: str,
        now: datetime,
        on_progress: Callable[[int, int], None],
    ) -> int:
        """Write all of it; returns the number of views that there were when this began."""
        row = find_map(connection, name)
        record = map_record(connection, row)
        recipe = find_recipe(connection, row.recipe)
        own = VIEW_ROWS.c.map_id == row.id
        sizes = sa.select(VIEW_ROWS.c.seq, VIEW_ROWS.c.byte_count).where(own).order_by(VIEW_ROWS.c.seq)
        views = [SizedView(*view) for view in connection.execute(sizes)]
        self._require_space(connection, row, len(views))
        facts = SnapshotFacts(
            id=snapshot_id,
            map=name,
            map_created_at=row.created_at,
            created_at=now,
            revision=row.revision,
            views=len(views),
            image_bytes=0,
            row_bytes=0,
            description=recipe,
            ranking=record.ranking,
            calibration=record.calibration,
            keep_images=record.keep_images,
            keep_queries=record.keep_queries,
            keep_matches=record.keep_matches,
            refuse_poor=record.refuse_poor,
            blur=record.blur,
        )
        writer = SnapshotWriter(file, facts)
        try:
            left_out = self._write_parts(connection, writer, row, recipe, views, on_progress)
            counts = {"image_bytes": writer.image_bytes, "row_bytes": writer.row_bytes}
            writer.end(facts.model_copy(update={"views": len(views) - len(left_out), **counts}))
        finally:
            writer.close()
        return len(views)

    def _write_parts(
        self,
        connection: sa.Connection,
        writer: SnapshotWriter,
        row: sa.Row[Any],
        recipe: DescriptionRecipe,
        views: Sequence[SizedView],
        on_progress: Callable[[int, int], None],
    ) -> set[int]:
        """Write all parts; returns the sequence numbers of views that were deleted meanwhile."""
        trained = sa.select(VOCABULARIES.c.tensors).where(VOCABULARIES.c.digest == recipe.vocabulary)
        if (tensors := connection.scalar(trained)) is not None:
            writer.add(VOCABULARY, [tensors])
        left_out: set[int] = set()
        done = 0
        for portion in Portions(self._database, self._images, connection, row.id, recipe).all(views):
            on_progress(done, len(views))
            writer.add_images(portion.images)
            writer.add_views(
                [view.line for view in portion.views], [body for view in portion.views for body in view.bodies]
            )
            left_out |= portion.left_out
            done += len(portion.views) + len(portion.left_out)
        for lines in comparison_lines(connection, row.id, row.recipe, left_out, COMPARISON_PORTION):
            writer.add_lines(COMPARISONS, lines)
        return left_out

    def _require_space(self, connection: sa.Connection, row: sa.Row[Any], views: int) -> None:
        """Raise DiskFull unless there is room for all of it."""
        if self._database.space is None:
            return
        own = VIEW_ROWS.c.map_id == row.id, needs_image(connection)
        images = connection.scalar(sa.select(sa.func.sum(VIEW_ROWS.c.byte_count)).where(*own)) or 0
        some = sa.select(sa.func.length(CELLS.c.body)).where(CELLS.c.recipe == row.recipe).limit(SAMPLE)
        sizes = list(connection.scalars(some))
        described = 3 * views * max(sizes, default=0)  # cells are some half of a description
        self._database.space.admit(int(images) + described)

    # kept

    def all(self) -> list[SnapshotRecord]:
        """All snapshots, newest first; one whose beginning cannot be read is logged and left out."""
        records = []
        with translated("snapshots"):
            kept = self._place.ids()
        for snapshot_id in kept:
            try:
                records.append(self.get(snapshot_id))
            except (BadSnapshot, NotFound) as error:
                if isinstance(error, NotFound) and _ID.fullmatch(snapshot_id):
                    continue  # it was deleted meanwhile
                log.error("snapshot %s is left out of the list: %s", snapshot_id, error.detail)
        return sorted(records, key=lambda record: (record.facts.created_at, record.facts.id), reverse=True)

    def get(self, snapshot_id: str) -> SnapshotRecord:
        """One snapshot; raises NotFound, BadSnapshot."""
        with _found(snapshot_id):
            return SnapshotRecord(*self._place.facts(snapshot_id))

    def holding(self, digests: Collection[str], started: Sequence[str] = ()) -> tuple[Holding, ...]:
        """As `SnapshotContents.holding`."""
        return self._contents.holding(digests, started)

    def open(self, snapshot_id: str) -> BinaryIO:
        """The file of a snapshot, for reading; it can be read to its end even if it is deleted meanwhile.

        From an object store, where the connection breaks after that, reading it raises FileNotFoundError.
        """
        with _found(snapshot_id):
            return self._place.open(snapshot_id)

    def delete(self, snapshot_id: str) -> None:
        """Remove a snapshot; raises NotFound."""
        with _found(snapshot_id):
            self._place.remove(snapshot_id)

    def receiving(self, name: str) -> Path:
        """Where a snapshot that is sent to this service is kept until it is restored."""
        with translated("snapshots"):
            self._folder.mkdir(exist_ok=True)
        return self._folder / f"{RECEIVING}{name}"

    def sweep(self) -> None:
        """Remove what a crash left: received files, and unfinished ones that no job will finish."""
        for path in self._folder.glob(f"{RECEIVING}*"):
            path.unlink(missing_ok=True)
        for path in self._folder.glob(f"{WRITING}*"):
            job = JOBS.c.id == path.name.removeprefix(WRITING).partition(".")[0]
            with self._database.reading() as connection:
                state = connection.scalar(sa.select(JOBS.c.state).where(job))
            if state not in ("waiting", "running"):
                path.unlink(missing_ok=True)

    def drop_draft(self, snapshot_id: str) -> None:
        """Remove the unfinished file of a snapshot, if there is one."""
        drop_drafts(self._folder, snapshot_id)

    def admit(self, size: int) -> None:
        """Raise DiskFull unless there is room for a file of `size` bytes."""
        if self._database.space is not None:
            self._database.space.admit(size)


@contextmanager
def _found(snapshot_id: str) -> Iterator[None]:
    """Raise NotFound where a block finds that there is no such snapshot, and for what can be no id of one."""
    if not _ID.fullmatch(snapshot_id):
        raise NotFound("snapshot", snapshot_id[:64])
    try:
        with translated("snapshots"):
            yield
    except FileNotFoundError:
        raise NotFound("snapshot", snapshot_id) from None
