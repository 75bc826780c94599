"""Looking after what is enrolled: views, maps, places, jobs and the pictures that explain them."""

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TypeVar

from app.http import presenters
from app.http.changes import Changes
from app.http.explanations import Explanations
from schemas import wire
from schemas.description import PixelField
from schemas.image import Image
from schemas.records import Filters, MapRecord, Replay, ViewAttributes, ViewRecord
from worker.description.describer import Describer
from worker.description.presets import make_recipe
from worker.images import drawing
from worker.runtime import Runtime

T = TypeVar("T")


class Curator:
    """Everything users do besides enrolling and asking.

    Parameters
    ----------
    runtime : Runtime
    explanations : Explanations
        Of the latest queries.
    changes : Changes
        Of whole maps, in the background.
    """

    def __init__(self, runtime: Runtime, explanations: Explanations, changes: Changes) -> None:
        self._runtime = runtime
        self._store = runtime.store
        self._explanations = explanations
        self._changes = changes

    # views

    async def view(self, view_id: str) -> wire.View:
        """One view."""
        return await self._answer(await asyncio.to_thread(self._store.view, view_id))

    async def attributes_of(self, view_id: str) -> ViewAttributes:
        """What the user said about a view."""
        return (await asyncio.to_thread(self._store.view, view_id)).attributes

    async def views(
        self,
        map_name: str | None,
        filters: Filters,
        *,
        state: str | None,
        newest_first: bool,
        cursor: str | None,
        limit: int,
    ) -> wire.Views:
        """A page of views."""

        def page() -> wire.Views:
            records, following = self._store.views(
                map_name, filters, state=state, newest_first=newest_first, cursor=cursor, limit=limit
            )
            labels = {name: self._store.map(name).recipe.labels for name in {r.map for r in records}}
            return wire.Views(views=[presenters.view(r, labels[r.map]) for r in records], next=following)

        return await asyncio.to_thread(page)

    async def patch_view(self, view_id: str, attributes: ViewAttributes) -> wire.View:
        """Replace what was said about a view."""
        return await self._answer(await asyncio.to_thread(self._store.patch, view_id, attributes))

    async def delete_view(self, view_id: str) -> wire.Deleted:
        """Remove a view."""
        return presenters.removal(await asyncio.to_thread(self._store.delete_view, view_id))

    async def delete_views(self, map_name: str, filters: Filters) -> wire.Deleted:
        """Remove the views of a map that fit."""
        return presenters.removal(await asyncio.to_thread(self._store.delete_views, map_name, filters))

    async def _answer(self, record: ViewRecord) -> wire.View:
        owner = await asyncio.to_thread(self._store.map, record.map)
        return presenters.view(record, owner.recipe.labels)

    # pictures

    async def image(self, view_id: str) -> tuple[bytes, str]:
        """The enrolled bytes and their media type."""
        record = await asyncio.to_thread(self._store.view, view_id)
        return await asyncio.to_thread(self._store.image, view_id), f"image/{record.image.format}"

    async def thumbnail(self, view_id: str, longest: int) -> bytes:
        """A JPEG of at most `longest` pixels on its longer side."""
        data = await asyncio.to_thread(self._store.image, view_id)
        return await asyncio.to_thread(self._runtime.thumbnail, data, longest)

    async def segmentation(self, view_id: str, overlay: bool) -> bytes:
        """The label map as an indexed PNG, or blended over the photo; as fine as the encoder has it."""

        def draw(image: Image, field: PixelField, describer: Describer) -> bytes:
            description = describer.see(field)
            recipe = describer.recipe
            if overlay:
                return drawing.overlay_png(image.pixels, description.labels, recipe.labels, description.static)
            return drawing.segmentation_png(description.labels, (image.width, image.height), recipe.labels)

        return await self._draw(view_id, draw, fine=True)

    async def graph(self, view_id: str) -> bytes:
        """The context graph, drawn over the photo."""

        def draw(image: Image, field: PixelField, describer: Describer) -> bytes:
            graph = describer.graph(field, describer.see(field))
            recipe = describer.recipe
            return drawing.graph_png(image.pixels, graph, recipe.labels, recipe.parameters.graph.tau)

        return await self._draw(view_id, draw)

    async def _draw(
        self, view_id: str, draw: Callable[[Image, PixelField, Describer], bytes], *, fine: bool = False
    ) -> bytes:
        owner, data = await asyncio.to_thread(self._source, view_id)
        image = await asyncio.to_thread(self._runtime.decode, data)
        describer = await asyncio.to_thread(self._runtime.describers.of, owner.recipe)
        future = self._runtime.scheduler.submit(image, lambda p, f: draw(p, f, describer), urgent=True, fine=fine)
        return (await asyncio.wrap_future(future)).value

    def _source(self, view_id: str) -> tuple[MapRecord, bytes]:
        record = self._store.view(view_id)
        return self._store.map(record.map), self._store.image(view_id)

    async def view_etag(self, view_id: str, kind: str) -> str:
        """Changes whenever a picture made of the view would; `kind` names the picture and its options."""
        record = await asyncio.to_thread(self._store.view, view_id)
        if kind.startswith(("image", "thumbnail")):
            return f'"{record.image.sha256[:24]}-{kind}"'
        owner = await asyncio.to_thread(self._store.map, record.map)
        return f'"{record.id}-{owner.recipe.id}-{kind}"'

    async def explanation(self, query_id: str, view_id: str | None) -> bytes:
        """Query and match side by side, with what agrees between them."""
        explained = self._explanations.get(query_id)
        found = explained.match(view_id)
        data = await asyncio.to_thread(self._store.image, found.view.id)
        return await asyncio.to_thread(lambda: explained.draw(found, self._runtime.decode(data)))

    # maps

    async def maps(self) -> wire.Maps:
        """All maps."""
        return await asyncio.to_thread(lambda: wire.Maps(maps=[self._facts(r) for r in self._store.maps()]))

    async def map(self, name: str) -> wire.MapFacts:
        """One map."""
        return await asyncio.to_thread(lambda: self._facts(self._store.map(name)))

    async def put_map(self, name: str, wanted: wire.PutMap) -> tuple[wire.MapFacts, bool]:
        """Make a map, or give an empty one another recipe; returns it and whether it is new."""

        def put() -> tuple[wire.MapFacts, bool]:
            recipe = make_recipe(
                self._runtime.encoder,
                wanted.preset or self._runtime.settings.preset,
                labels=wanted.labels,
                dynamic=wanted.dynamic,
                parameters=wanted.parameters,
            )
            record, created = self._store.put_map(name, recipe, _now())
            return self._facts(record), created

        return await asyncio.to_thread(put)

    async def delete_map(self, name: str) -> wire.Deleted:
        """Remove a map and all its views."""
        receipt = await asyncio.to_thread(self._store.delete_map, name)
        self._runtime.catalogue.forget(name)
        return presenters.removal(receipt)

    def _facts(self, record: MapRecord) -> wire.MapFacts:
        recipe = record.recipe
        own = (recipe.encoder, recipe.weights) == (self._runtime.encoder.name, self._runtime.encoder.digest)
        meanings = self._runtime.encoder.meanings(recipe.labels) if own else presenters.unexplained(recipe.labels)
        return presenters.map_facts(record, self._store.counts(record.name), meanings)

    async def places(self, map_name: str | None, cursor: str | None, limit: int) -> wire.Places:
        """A page of places."""
        rows, following = await asyncio.to_thread(self._store.places, map_name, cursor, limit)
        return wire.Places(places=[presenters.place(row) for row in rows], next=following)

    # jobs

    async def switch_recipe(self, name: str, wanted: wire.PutMap) -> wire.Job:
        """Describe a map's views by another recipe, in the background."""
        return await asyncio.to_thread(self._changes.switch, name, wanted)

    async def train_vocabulary(self, name: str) -> wire.Job:
        """Train a vocabulary on a map's own views and describe them by it, in the background."""
        return await asyncio.to_thread(self._changes.train, name)

    async def job(self, job_id: str) -> wire.Job:
        """One job."""
        change = await asyncio.to_thread(self._changes.job, job_id)
        return change or presenters.job(await asyncio.to_thread(self._store.job, job_id))

    async def cancel_job(self, job_id: str) -> wire.Job:
        """Cancel a job that is waiting."""
        return presenters.job(await asyncio.to_thread(self._store.cancel, job_id, _now()))

    # repeated calls

    async def begin_call(self, key: str, fingerprint: str) -> Replay | None:
        """Claim an Idempotency-Key; see `Store.begin_call`."""
        return await asyncio.to_thread(self._store.begin_call, key, fingerprint, _now())

    async def end_call(self, key: str, replay: Replay) -> None:
        """Remember a call's answer."""
        await asyncio.to_thread(self._store.end_call, key, replay, _now())

    async def abandon_call(self, key: str) -> None:
        """Forget a call that failed."""
        await asyncio.to_thread(self._store.abandon_call, key)


def _now() -> datetime:
    return datetime.now(UTC)
