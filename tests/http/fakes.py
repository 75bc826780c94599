"""A runtime without networks and without a database, for tests of the HTTP interface.

It keeps views in dictionaries, checks images with the real codec, and fails on demand.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Collection
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, cast

from fastapi import FastAPI
from uuid6 import uuid7

from app.http.application import application
from app.http.curate import Curator
from app.http.examples import MAP_HEALTH, MATCH, QUERY_ANSWER, VIEW
from app.http.keys import Keys, NoKeys
from app.http.lifecycle import Lifecycle
from app.http.recognise import Recogniser
from app.http.service import Service
from schemas import wire
from schemas.errors import Conflict, KeyReused, NotFound, RevisitError
from schemas.image import ImageFacts
from schemas.records import Filters, Replay, ViewAttributes
from schemas.requests import PostRecipe, PutMap
from schemas.settings import Settings
from schemas.statistics import (
    IndexLag,
    LiveStatistics,
    MapStatistics,
    QueueStatistics,
    ServiceStatistics,
    StoreStatistics,
)
from tests.http.fake_changes import FakeChanges
from tests.http.fake_inbox import FakeInbox
from tests.http.fake_shadows import FakeShadows
from tests.http.fake_snapshots import FakeSnapshots
from worker.images.codec import Limits, decode, facts, thumbnail
from worker.service.query_options import QueryOptions

NOW = datetime(2026, 3, 1, 9, 30, tzinfo=UTC)


@dataclass
class Kept:
    """A view of the fake."""

    id: str
    map: str
    attributes: ViewAttributes
    data: bytes
    facts: ImageFacts

    def view(self) -> wire.View:
        position = wire.Position(**vars(self.attributes.position))
        return wire.View(
            id=self.id,
            map=self.map,
            place=self.attributes.place,
            position=position if any(value is not None for _, value in position) else None,
            captured_at=self.attributes.captured_at,
            enrolled_at=NOW,
            metadata=dict(self.attributes.metadata),
            filename=self.attributes.filename,
            image=wire.ImageFacts(
                width=self.facts.width,
                height=self.facts.height,
                bytes=self.facts.byte_count,
                format=self.facts.format,
                sha256=self.facts.sha256,
            ),
            state="ready",
            description=wire.DescriptionFacts.model_validate(VIEW["description"]),
            links=wire.ViewLinks.model_validate({k: v.replace(VIEW["id"], self.id) for k, v in VIEW["links"].items()}),
        )


@dataclass
class FakeRecogniser(FakeSnapshots, FakeShadows, FakeInbox, FakeChanges):
    """Use-cases that answer like the real ones but describe nothing."""

    limits: Limits = field(default_factory=lambda: Limits(max_bytes=2_000_000, max_pixels=1_000_000))
    kept: dict[str, Kept] = field(default_factory=dict)
    calls: dict[str, tuple[str, Replay | None]] = field(default_factory=dict)
    fails: dict[str, BaseException] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)
    made: dict[str, PutMap] = field(default_factory=dict)
    hold: asyncio.Event | None = None
    enrolments: int = 0
    events: list[str] = field(default_factory=list)
    job_states: list[str] = field(default_factory=lambda: ["done"])
    job_kind: str = "describe"
    started: bool = True
    draining: bool = False

    def _may_fail(self, name: str) -> None:
        if name in self.fails:
            raise self.fails[name]

    async def enroll(
        self,
        images: list[Any],
        map_name: str,
        attributes: ViewAttributes,
        wait: bool,
        stored: Callable[[], object] = lambda: None,
        **given: bool | None,
    ) -> list[wire.Enrolled | RevisitError]:
        self._may_fail("enroll")
        self.given = {"map": map_name, "said": attributes, "wait": wait, "names": [name for name, _ in images]}
        self.given |= given
        self.enrolments += 1
        stored()
        if self.hold is not None:
            await self.hold.wait()
        return [self._enroll(data, map_name, replace(attributes, filename=name), wait) for name, data in images]

    def _enroll(
        self, data: bytes, map_name: str, attributes: ViewAttributes, wait: bool
    ) -> wire.Enrolled | RevisitError:
        try:
            self._may_fail("enroll_one")
            seen = facts(decode(data, self.limits))
            known = next((k for k in self.kept.values() if (k.map, k.facts.sha256) == (map_name, seen.sha256)), None)
            told = replace(attributes, filename=None)
            if known is not None and replace(known.attributes, filename=None) != told and told != ViewAttributes():
                raise Conflict("these bytes are in the map already, with something else said about them")
        except RevisitError as error:
            return error
        kept = known or Kept(str(uuid7()), map_name, attributes, data, seen)
        self.kept[kept.id] = kept
        return wire.Enrolled(
            view=kept.view(),
            created=known is None,
            revision=len(self.kept),
            job=None if wait or known else "0195f2a4-0000-7000-8000-000000000001",
            timing_ms={"decode": 1.0, "total": 2.0},
        )

    async def query(self, image: bytes, *maps: str, options: QueryOptions, caller: Any = None) -> wire.QueryAnswer:
        map_name = maps[0]
        self._may_fail("query")
        decode(image, self.limits)
        self.given = {"map": ",".join(maps), **vars(options)}
        views = [kept for kept in self.kept.values() if kept.map == map_name]
        if not views:
            raise NotFound("map", map_name)
        matches = [
            wire.Match.model_validate({**MATCH, "rank": rank, "view": kept.view().model_dump()})
            for rank, kept in enumerate(views[: options.top], 1)
        ]
        return wire.QueryAnswer.model_validate({**QUERY_ANSWER, "map": map_name}).model_copy(
            update={"matches": matches, "searched": len(views)}
        )

    def _view(self, view_id: str) -> Kept:
        if view_id not in self.kept:
            raise NotFound("view", view_id)
        return self.kept[view_id]

    async def view(self, view_id: str) -> wire.View:
        self._may_fail("view")
        return self._view(view_id).view()

    async def views(
        self, map_name: str | None, filters: Filters, *, among: Collection[str] | None = None, **how: Any
    ) -> wire.Views:
        self.given = {"map": map_name, "filters": filters, **how}
        kept = [k for k in self.kept.values() if map_name in (None, k.map) and (among is None or k.map in among)]
        return wire.Views(views=[k.view() for k in kept], next=None)

    async def views_with_words(self, map_name: str, filters: Filters, words: str, **how: Any) -> wire.Views:
        self.given = {"words": words, **how}
        return await self.views(map_name, filters)

    async def patch_view(self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> wire.View:
        kept = self._view(view_id)
        kept.attributes = change(kept.attributes)
        return self._view(view_id).view()

    async def delete_view(self, view_id: str) -> wire.Deleted:
        self._view(view_id)
        del self.kept[view_id]
        return wire.Deleted(views=1, images=1, revision=2)

    async def delete_views(self, map_name: str, filters: Filters) -> wire.Deleted:
        self.given = {"map": map_name, "filters": filters}
        gone = [key for key, kept in self.kept.items() if kept.map == map_name]
        for key in gone:
            del self.kept[key]
        return wire.Deleted(views=len(gone), images=len(gone), revision=2)

    async def image(self, view_id: str) -> tuple[bytes, str]:
        kept = self._view(view_id)
        return kept.data, f"image/{kept.facts.format}"

    async def thumbnail(self, view_id: str, longest: int) -> bytes:
        return thumbnail(self._view(view_id).data, longest)

    async def segmentation(self, view_id: str, overlay: bool, legend: bool) -> bytes:
        self._view(view_id)
        return (b"overlay" if overlay else b"segmentation") + b" with legend" * legend

    def segmented_by(self) -> str:
        return "segmenter"

    async def graph(self, view_id: str, legend: bool) -> bytes:
        self._view(view_id)
        return b"graph" + b" with legend" * legend

    async def explanation(self, query_id: str, view_id: str | None) -> bytes:
        raise NotFound("explained query", query_id)

    async def maps_of_query(self, query_id: str) -> tuple[str, ...]:
        raise NotFound("explained query", query_id)

    async def view_etag(self, view_id: str, kind: str) -> str:
        return f'"{self._view(view_id).facts.sha256[:12]}-{kind}"'

    async def maps(self, among: Collection[str] | None = None) -> str:
        self._may_fail("maps")
        names = sorted(name for name in {k.map for k in self.kept.values()} if among is None or name in among)
        return wire.Maps(maps=[self._facts(name) for name in names]).model_dump_json()

    async def map(self, name: str) -> wire.MapFacts:
        if name not in self.made and name not in {k.map for k in self.kept.values()}:
            raise NotFound("map", name)
        return self._facts(name)

    def _facts(self, name: str) -> wire.MapFacts:
        return wire.MapFacts(
            name=name,
            revision=len(self.kept),
            views={"pending": 0, "ready": len(self.kept), "failed": 0},
            places=1,
            bytes=1,
            recipe={"id": "4c1d9ab02e7f6a35"},
            ranking={"id": "97b1f2c0d3e4a586"},
            decision=wire.MapDecision(
                source="cohort",
                views_compared=0,
                expected=wire.ExpectedDecisions(precision=0.97, matched_share=0.5),
                updated_at=None,
            ),
            labels=[],
            vocabulary={},
            extent=None,
            created_at=NOW,
        )

    async def health(self, name: str, code: str | None, limit: int) -> wire.MapHealth:
        await self.map(name)
        self.given = {"map": name, "code": code, "limit": limit}
        return wire.MapHealth.model_validate({**MAP_HEALTH, "map": name})

    async def put_map(self, name: str, wanted: PutMap) -> tuple[wire.MapFacts, bool]:
        if any(kept.map == name for kept in self.kept.values()):
            raise Conflict(f"the map {name!r} has views; POST /maps/{name}/recipe describes them anew")
        created = name not in self.made
        self.made[name] = wanted
        return self._facts(name), created

    async def forget_calibration(self, name: str) -> wire.MapFacts:
        return await self.map(name)

    async def delete_map(self, name: str) -> wire.Deleted:
        await self.map(name)
        return wire.Deleted(views=0, images=0, revision=None)

    async def places(
        self, map_name: str | None, cursor: str | None, limit: int, among: Collection[str] | None = None
    ) -> wire.Places:
        hall = wire.Place(map="default", place="hall", views=2, position=None, last_enrolled_at=NOW)
        return wire.Places(places=[hall] if among is None or hall.map in among else [], next=None)

    def _job(self, job_id: str) -> wire.Job:
        return wire.Job(
            id=job_id,
            kind="describe",
            state="waiting",
            map="default",
            view=None,
            attempts=0,
            progress=None,
            result=None,
            created_at=NOW,
            finished_at=None,
            failure=None,
            links={"self": f"/jobs/{job_id}"},
        )

    async def switch_recipe(self, name: str, wanted: PostRecipe) -> wire.Job:
        await self.map(name)
        return self._job("j1")

    async def train_vocabulary(self, name: str) -> wire.Job:
        await self.map(name)
        return self._job("j2")

    async def import_recording(
        self, name: str, body: AsyncIterator[bytes], announced: int, charge: Callable[[int], None], options: Any
    ) -> wire.Job:
        async for _ in body:
            pass
        return self._job("j3")

    async def job(self, job_id: str) -> wire.Job:
        if job_id == "gone":
            raise NotFound("job", job_id)
        state = self.job_states.pop(0) if len(self.job_states) > 1 else self.job_states[0]
        return self._job(job_id).model_copy(update={"state": state, "kind": self.job_kind})

    async def cancel_job(self, job_id: str) -> wire.Job:
        raise Conflict(f"the job {job_id!r} is running already")

    def beyond_help(self) -> str | None:
        return None

    async def readiness(self) -> wire.Readiness:
        self._may_fail("readiness")
        if self.hold is not None:
            await self.hold.wait()
        return wire.Readiness(ready=True, checks={"store": "ok", "encoder": "ok"})

    async def version(self) -> wire.Version:
        return wire.Version(
            version="0.1.0",
            encoder="color",
            weights="none",
            terms="none",
            preset="default",
            schema_version="0001",
            python="3.11",
            libraries={},
        )

    async def begin_call(self, key: str, fingerprint: str) -> Replay | None:
        if key not in self.calls:
            self.calls[key] = (fingerprint, None)
            return None
        known, replay = self.calls[key]
        if known != fingerprint:
            raise KeyReused("this Idempotency-Key was used for another request")
        if replay is None:
            raise Conflict("the first call with this Idempotency-Key still runs")
        return replay

    async def end_call(self, key: str, replay: Replay) -> None:
        self._may_fail("end_call")
        self.calls[key] = (self.calls[key][0], replay)

    async def abandon_call(self, key: str) -> None:
        del self.calls[key]

    def live(self) -> LiveStatistics:
        return LiveStatistics(queries_waiting=2, encoder_alive=True, worker_alive=True)

    async def statistics(self) -> tuple[ServiceStatistics | None, float]:
        names = sorted({kept.map for kept in self.kept.values()})
        maps = tuple(
            MapStatistics(name, 1, {"ready": sum(k.map == name for k in self.kept.values())}, 10, 0) for name in names
        )
        queues = (QueueStatistics("describe", 3, 1, 4.5),)
        return ServiceStatistics(StoreStatistics(maps, queues, 100), {"m": IndexLag(1, 2.0)}, 10, 20, (1.5,)), 0.1

    async def start(self) -> None:
        self.events.append("start")

    async def stop(self) -> None:
        self.events.append("stop")

    async def jobs(self, map_name: str | None, *, among: Collection[str] | None = None, **how: Any) -> wire.Jobs:
        self.given = {"map": map_name, **how}
        return wire.Jobs(jobs=[self._job("j1")] if among is None or "default" in among else [], next=None)


@dataclass
class FakeRuntime:
    """Stands for the runtime and, by its methods, for all use-cases."""

    recogniser: FakeRecogniser = field(default_factory=FakeRecogniser)
    settings: Settings = field(default_factory=lambda: Settings(max_body_mb=2, max_megapixels=1))
    keys: Keys = field(default_factory=NoKeys)

    def app(self, tracer_provider: Any = None) -> FastAPI:
        """The application of this runtime."""
        fake = self.recogniser
        use_cases = cast(Recogniser, fake), cast(Curator, fake), cast(Lifecycle, fake)
        return application(Service(*use_cases, self.settings, self.keys), tracer_provider)
