"""Use-cases for views, images, maps and jobs: each runs in a thread, and its result becomes an answer."""

import asyncio
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol

from app.http import presenters, snapshot_presenters
from app.http.calibration_report import calibration_report
from app.http.curate_changes import ChangeCuration
from app.http.curate_kept import KeptQueryCuration
from app.http.curate_shadow import RecipeCuration, wanted_of
from app.http.health_report import map_health
from app.http.long_work import LongWork
from app.http.receiving import in_pieces
from schemas import wire
from schemas.health import Code as HealthCode
from schemas.imports import ImportOptions
from schemas.records import Filters, JobKind, JobState, Position, Replay, ViewAttributes
from schemas.requests import PatchMap, PostCalibration, PutMap
from worker.service import steady
from worker.service.calibrating import LabelledView, ObservedAnswer

if TYPE_CHECKING:
    from worker.runtime.services import Services


class Calls(Protocol):
    """Remembers the answers to calls with an Idempotency-Key for 24 hours; `worker.storage.calls.Calls` is one."""

    def begin(self, key: str, fingerprint: str, now: datetime, *, shared: bool = False) -> Replay | None:
        """Claim a key; returns the answer to repeat when the call with that key has finished, else None.

        `shared`: go by a clock that all services of a fleet share, if there is one, instead of `now`.

        Raises
        ------
        Conflict
            The call with that key still runs.
        KeyReused
            The key was used with another fingerprint.
        """
        ...

    def end(self, key: str, replay: Replay, now: datetime) -> None:
        """Remember the answer to a call."""
        ...

    def abandon(self, key: str) -> None:
        """Forget a call that failed, so that it can be tried again."""
        ...


DRAWN_AT_ONCE = 2
"""Photos that are drawn on or compared at once: one while the network finds what to draw on the next. As many
explanations are drawn, which need no network and wait for none of them."""

READ_AT_ONCE = 2
"""Images that are read at once: each is in memory three times over, and what is read is written before more is."""


class Curator(KeptQueryCuration, RecipeCuration, ChangeCuration):
    """Everything a user does besides enrolling and querying.

    Parameters
    ----------
    services : Services
    calls : Calls
        Answers of calls with an Idempotency-Key.
    """

    def __init__(self, services: "Services", calls: Calls) -> None:
        self._services, self._calls = services, calls
        self._long = LongWork()
        self._writes = LongWork(None, "revisit-writes")
        self._drawings = LongWork(DRAWN_AT_ONCE, "revisit-drawings")
        self._explanations = LongWork(DRAWN_AT_ONCE, "revisit-explanations")
        self._images = asyncio.Semaphore(READ_AT_ONCE)

    # views

    async def view(self, view_id: str) -> wire.View:
        """One view."""
        return presenters.labelled_view(await asyncio.to_thread(self._services.views.get, view_id))

    async def views(
        self,
        map_name: str | None,
        filters: Filters,
        *,
        state: str | None,
        newest_first: bool,
        cursor: str | None,
        limit: int,
        among: Collection[str] | None = None,
    ) -> wire.Views:
        """A page of views; `among`: of these maps alone."""
        page = partial(
            self._services.views.page, state=state, newest_first=newest_first, cursor=cursor, limit=limit, among=among
        )
        views, following = await asyncio.to_thread(page, map_name, filters)
        return wire.Views(views=[presenters.labelled_view(view) for view in views], next=following)

    async def views_with_words(
        self, map_name: str, filters: Filters, words: str, *, cursor: str | None, limit: int
    ) -> wire.Views:
        """A page of views by how much of them some labels are."""
        page = partial(self._services.views.with_words, map_name, filters, words, cursor=cursor, limit=limit)
        views, following = await asyncio.to_thread(page)
        return wire.Views(views=[presenters.labelled_view(view) for view in views], next=following)

    async def dynamic_preview(self, map_name: str, labels: Sequence[str], limit: int) -> wire.DynamicPreview:
        """What would be left out of a map's views if these labels were dynamic."""
        preview = await self._long.run(self._services.views.preview_dynamic, map_name, labels, limit)
        return presenters.dynamic_preview(map_name, preview)

    async def patch_view(self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> wire.View:
        """Replace the attributes of a view by `change` of them; the store does both in one transaction."""
        return presenters.labelled_view(await self._writes.run(self._services.views.change, view_id, change))

    async def delete_view(self, view_id: str) -> wire.Deleted:
        """Remove a view."""
        return snapshot_presenters.removal(await self._writes.run(self._services.views.delete, view_id))

    async def delete_views(self, map_name: str, filters: Filters) -> wire.Deleted:
        """Remove the views of a map that pass the filters."""
        return snapshot_presenters.removal(
            await self._long.run(self._services.views.delete_matching, map_name, filters)
        )

    async def places(
        self, map_name: str | None, cursor: str | None, limit: int, among: Collection[str] | None = None
    ) -> wire.Places:
        """A page of places; `among`: of these maps alone."""
        rows, following = await asyncio.to_thread(self._services.views.places, map_name, cursor, limit, among)
        return wire.Places(places=[presenters.place(row) for row in rows], next=following)

    # images

    async def image(self, view_id: str) -> tuple[bytes, str]:
        """The enrolled bytes of a view's image, and their media type."""
        async with self._images:
            return await asyncio.to_thread(self._services.renderings.image, view_id)

    async def thumbnail(self, view_id: str, longest: int) -> bytes:
        """A JPEG of at most `longest` pixels on its longer side."""
        return await asyncio.to_thread(self._services.renderings.thumbnail, view_id, longest)

    async def segmentation(self, view_id: str, overlay: bool, legend: bool) -> bytes:
        """The segmentation of a view as an indexed PNG, or blended over the photo, with or without a key."""
        segmentation = partial(self._services.renderings.segmentation, overlay=overlay, legend=legend)
        return await self._drawings.run(segmentation, view_id)

    def segmented_by(self) -> str:
        """The network whose labels a segmentation shows."""
        return self._services.renderings.segmented_by

    async def graph(self, view_id: str, legend: bool) -> bytes:
        """The context graph, drawn over the photo, with or without a key."""
        return await self._drawings.run(partial(self._services.renderings.graph, legend=legend), view_id)

    async def view_etag(self, view_id: str, kind: str) -> str:
        """An ETag that changes whenever the image does; `kind` names the image and its options."""
        return f'"{await asyncio.to_thread(self._services.renderings.version, view_id, kind)}"'

    async def explanation(self, query_id: str, view_id: str | None) -> bytes:
        """A PNG of what decided about a match."""
        return await self._explanations.run(self._services.renderings.explanation, query_id, view_id)

    async def maps_of_query(self, query_id: str) -> tuple[str, ...]:
        """The maps of an explained query; raises NotFound."""
        return self._services.renderings.maps_of_query(query_id)

    # maps

    async def maps(self, among: Collection[str] | None = None) -> str:
        """`wire.Maps` of all maps, or of those of some names, as JSON.

        Of thousands it takes seconds: it is made in a thread, one map after the other, so that others are answered.
        """

        def as_json() -> str:
            told = (presenters.map_facts(state).model_dump_json() for state in self._services.maps.all(among))
            return f'{{"maps":[{",".join(told)}]}}'

        return await asyncio.to_thread(as_json)

    async def map(self, name: str) -> wire.MapFacts:
        """One map."""
        return presenters.map_facts(await asyncio.to_thread(self._services.maps.get, name))

    async def put_map(self, name: str, wanted: PutMap) -> tuple[wire.MapFacts, bool]:
        """Make a map, or give an empty one another recipe; returns the map and whether it is new."""
        state, created = await asyncio.to_thread(self._services.maps.put, name, wanted_of(wanted))
        return presenters.map_facts(state), created

    async def change_map(self, name: str, changes: PatchMap) -> wire.MapFacts:
        """Change what is given of a map, all of it or nothing."""
        change = partial(
            self._services.maps.change,
            ranking=changes.ranking,
            blur=changes.blur,
            keep_images=changes.keep_images,
            keep_queries=changes.keep_queries,
            keep_matches=changes.keep_matches,
            refuse_poor=changes.refuse_poor,
        )
        return presenters.map_facts(await asyncio.to_thread(change, name))

    async def calibrate(self, name: str, labels: PostCalibration) -> wire.CalibrationReport:
        """Fit a map's calibration to labelled queries, judge it, and keep it if it helps."""
        observed = [ObservedAnswer(o.features, o.right, o.known, o.block) for o in labels.observed]
        queries = [
            LabelledView(q.view, q.place, None if q.position is None else Position(**q.position.model_dump()), q.block)
            for q in labels.queries
        ]
        calibrate = partial(
            self._services.calibration.calibrate,
            recipe=labels.recipe,
            ranking=labels.ranking,
            within_m=labels.within,
            trial=labels.dry_run,
        )
        return calibration_report(await self._long.run(calibrate, name, observed, queries))

    async def forget_calibration(self, name: str) -> wire.MapFacts:
        """Return a map to the shipped calibration."""
        await asyncio.to_thread(self._services.calibration.forget, name)
        return await self.map(name)

    async def health(self, name: str, code: HealthCode | None, limit: int) -> wire.MapHealth:
        """What a map lacks or suffers from: at most `limit` findings of each kind, or of the kind `code`."""
        return map_health(await self._long.run(self._services.health.of, name), code, limit)

    async def delete_map(self, name: str) -> wire.Deleted:
        """Remove a map and all its views."""
        return snapshot_presenters.removal(await self._long.run(self._services.maps.delete, name))

    # jobs

    async def train_vocabulary(self, name: str) -> wire.Job:
        """Train a vocabulary on a map's own views and describe them by it, in the background."""
        return presenters.job(await asyncio.to_thread(self._services.maps.train_vocabulary, name))

    async def import_recording(
        self,
        name: str,
        body: AsyncIterator[bytes],
        announced: int,
        charge: Callable[[int], None],
        options: ImportOptions,
    ) -> wire.Job:
        """Receive a recording and queue its import.

        Parameters
        ----------
        name : str
            Of the map, which is made when there is none.
        body : async iterator of bytes
        announced : int
            Bytes that will come; 0: unknown.
        charge : function
            Called with the number of its images, once they are known.
        options : ImportOptions

        Raises
        ------
        SetupError
            The map was described by another encoder than the running one; nothing is received.
        BadBody, BodyTooLarge, DiskFull, StorageFailed
            Nothing of it is left.
        """
        await asyncio.to_thread(self._services.imports.admit, name)
        upload = await asyncio.to_thread(self._services.imports.receive, announced)
        try:
            async for piece in in_pieces(body):
                await asyncio.to_thread(upload.write, piece)
            charge(await self._long.run(self._services.imports.check, upload, options))
            return presenters.job(await asyncio.to_thread(self._services.imports.accept, upload, name, options))
        finally:
            await asyncio.to_thread(upload.discard)  # does nothing to one that was accepted

    async def job(self, job_id: str) -> wire.Job:
        """One job."""
        return presenters.job(await asyncio.to_thread(self._services.jobs.get, job_id))

    async def jobs(
        self,
        map_name: str | None,
        *,
        kinds: Collection[JobKind],
        state: JobState | None,
        cursor: str | None,
        limit: int,
        among: Collection[str] | None = None,
    ) -> wire.Jobs:
        """A page of jobs, newest first; `among`: of these maps alone."""
        page = partial(self._services.jobs.page, kinds=kinds, state=state, cursor=cursor, limit=limit, among=among)
        records, following = await asyncio.to_thread(page, map_name)
        return wire.Jobs(jobs=[presenters.job(record) for record in records], next=following)

    async def cancel_job(self, job_id: str) -> wire.Job:
        """Cancel a job."""
        return presenters.job(await asyncio.to_thread(self._services.jobs.cancel, job_id))

    # snapshots

    async def make_snapshot(self, name: str) -> wire.Job:
        """Make a snapshot of a map, in the background."""
        return presenters.job(await asyncio.to_thread(self._services.snapshots.queue, name))

    async def snapshots(self) -> wire.Snapshots:
        """All snapshots."""
        kept = await asyncio.to_thread(self._services.snapshots.all)
        return wire.Snapshots(snapshots=[snapshot_presenters.snapshot(record) for record in kept])

    async def snapshot(self, snapshot_id: str) -> wire.Snapshot:
        """One snapshot."""
        return snapshot_presenters.snapshot(await asyncio.to_thread(self._services.snapshots.get, snapshot_id))

    async def open_snapshot(self, snapshot_id: str) -> tuple[wire.Snapshot, BinaryIO]:
        """One snapshot, and its file for reading."""
        facts = await self.snapshot(snapshot_id)
        return facts, await asyncio.to_thread(self._services.snapshots.open, snapshot_id)

    async def delete_snapshot(self, snapshot_id: str) -> wire.Snapshot:
        """Remove a snapshot."""
        return snapshot_presenters.snapshot(await asyncio.to_thread(self._services.snapshots.delete, snapshot_id))

    async def receiving(self, name: str, size: int) -> Path:
        """Where a snapshot of `size` bytes is kept while it is received and restored; raises DiskFull."""
        await self.admit(size)
        return await asyncio.to_thread(self._services.snapshots.receiving, name)

    async def admit(self, size: int) -> None:
        """Raise DiskFull unless there is room for so many bytes."""
        await asyncio.to_thread(self._services.snapshots.admit, size)

    async def restore(self, path: Path, name: str | None, allow: Callable[[str], None]) -> wire.RestoredMap:
        """Make a map from a snapshot; see `SnapshotService.restore`."""
        return snapshot_presenters.restored(await self._long.run(self._services.snapshots.restore, path, name, allow))

    # repeated calls

    async def begin_call(self, key: str, fingerprint: str) -> Replay | None:
        """Claim an Idempotency-Key; see `Calls.begin`."""
        return await self._writes.run(self._calls.begin, key, fingerprint, steady.now(), shared=True)

    async def end_call(self, key: str, replay: Replay) -> None:
        """Remember the answer to a call; see `Calls.end`."""
        await self._writes.run(self._calls.end, key, replay, steady.now())

    async def abandon_call(self, key: str) -> None:
        """Forget a call that failed; see `Calls.abandon`."""
        await self._writes.run(self._calls.abandon, key)
