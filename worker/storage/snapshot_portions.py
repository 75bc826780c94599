"""Views of a map in portions, as they go into its snapshot."""

from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from typing import NamedTuple

import sqlalchemy as sa

from schemas.errors import Damaged
from schemas.recipe import DescriptionRecipe
from worker.storage.damage import Quarantine
from worker.storage.database import Database
from worker.storage.image_store import ImageStore, forgets
from worker.storage.snapshot_rows import WrittenView, first_elapsed, written_views
from worker.storage.tables import VIEWS

MOST_VIEWS, MOST_BYTES = 128, 16 * 1024 * 1024
"""Of a portion, and of its images; one that is larger goes alone. Three portions are in memory at once, or four."""

DAMAGED_DESCRIPTION = (
    "the description of the view {} is damaged, and its map keeps no image to make another from, so that no whole "
    "snapshot can be made; enrol its image again, or delete it"
)


@dataclass(frozen=True)
class Portion:
    """Some views of a snapshot.

    Parameters
    ----------
    views : list of WrittenView
    images : list of (str, bytes)
        SHA-256 and bytes, of views that go with their image.
    left_out : set of int
        Sequence numbers of views that were deleted meanwhile.
    """

    views: list[WrittenView] = field(default_factory=list)
    images: list[tuple[str, bytes]] = field(default_factory=list)
    left_out: set[int] = field(default_factory=set)


class SizedView(NamedTuple):
    """The sequence number of a view, and the bytes of its image."""

    seq: int
    size: int


class Portions:
    """Reads the views of a map by a recipe.

    Parameters
    ----------
    database : Database
    images : ImageStore
    connection : sqlalchemy.Connection
        A transaction that sees the map as the snapshot is to show it.
    map_id : int
    recipe : DescriptionRecipe
    """

    def __init__(
        self,
        database: Database,
        images: ImageStore,
        connection: sa.Connection,
        map_id: int,
        recipe: DescriptionRecipe,
    ) -> None:
        self._database, self._images, self._connection = database, images, connection
        self._map_id, self._recipe = map_id, recipe
        self._since_us = first_elapsed(connection, map_id)

    def all(self, views: Sequence[SizedView]) -> Iterator[Portion]:
        """Portions of views that are given in enrolment order; raises Damaged where one cannot be told whole.

        A thread beside reads the images of a portion while the rows of the next are read.
        """
        with ThreadPoolExecutor(1, "revisit-snapshot-images") as thread:
            last: Future[Portion] | None = None
            for seqs in portions(views):
                without = without_image(self._connection, self._map_id, seqs)
                rows = written_views(self._connection, seqs, self._recipe, self._since_us)
                before, last = last, thread.submit(copy_context().run, self._portion, seqs, rows, without)
                if before is not None:
                    yield before.result()
            if last is not None:
                yield last.result()

    def _portion(self, seqs: Sequence[int], views: Sequence[WrittenView], without: Collection[int]) -> Portion:
        """Views with their images, those in `without` apart, which need their descriptions."""
        portion = Portion()
        wanted = {seq: view.digest for seq, view in zip(seqs, views, strict=True) if seq not in without}
        images = dict(zip(wanted, self._images.read_each(list(wanted.values())), strict=True))
        for seq, view in zip(seqs, views, strict=True):
            image = images.get(seq)
            if image is None and not view.bodies:  # as it is, it could be restored from nothing
                image = Damaged(DAMAGED_DESCRIPTION.format(view.id))
            now = self._now(seq, image) if isinstance(image, Damaged) else view
            if now is None:
                portion.left_out.add(seq)
                continue
            portion.views.append(now)
            if isinstance(image, bytes):
                portion.images.append((view.digest, image))
        return portion

    def _now(self, seq: int, why: Damaged) -> WrittenView | None:
        """A view that lost its image as it is by now: without one, since it is described; None: it was deleted.

        Raises Damaged, `why`, where it needs its image. A damaged description is set aside, so that the image can be
        enrolled again.
        """
        with self._database.reading() as connection:
            if connection.scalar(sa.select(VIEWS.c.seq).where(VIEWS.c.seq == seq)) is None:
                return None
            if not without_image(connection, self._map_id, [seq]):
                raise why
            [view] = written_views(connection, [seq], self._recipe, self._since_us)
        if not view.bodies:
            Quarantine(self._database).descriptions({seq: ""}, self._recipe.id)
            raise why
        return view


def portions(views: Sequence[SizedView]) -> Iterator[list[int]]:
    """Sequence numbers of views, so many together as `MOST_VIEWS` and `MOST_BYTES` say."""
    together: list[int] = []
    size = 0
    for view in views:
        if together and (len(together) == MOST_VIEWS or size + view.size > MOST_BYTES):
            yield together
            together, size = [], 0
        together.append(view.seq)
        size += view.size
    if together:
        yield together


def without_image(connection: sa.Connection, map_id: int, seqs: Sequence[int]) -> set[int]:
    """Views of a map that go without their image: described ones, where the map keeps no images."""
    if not forgets(connection, map_id):
        return set()
    described = VIEWS.c.seq.in_(seqs), VIEWS.c.state == "ready"
    return set(connection.scalars(sa.select(VIEWS.c.seq).where(*described)))
