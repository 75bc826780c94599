"""The two use-cases revisit is for: enrol a picture, ask where one was taken. Ports in, answers out; no FastAPI."""

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from uuid6 import uuid7

from app.http import presenters
from app.http.explanations import Explained, Explanations
from app.http.waiter import Waiter
from schemas import wire
from schemas.description import Description
from schemas.errors import Busy, NothingStatic, RevisitError
from schemas.image import Image, ImageFacts
from schemas.records import Filters, Submitted, ViewAttributes
from worker.description.describer import Describer
from worker.description.scheduler import Timed
from worker.method.decision import decide
from worker.runtime import Runtime
from worker.search.searcher import Answer, RecipeChanged

COMPARED = 2
"""Matches searched for at least: how sure the first is depends on how far it leads, whatever was asked for."""

PATIENCE_S = 120.0
"""How long an enrolment waits for its description before it answers as if it had been told not to wait."""


@dataclass(frozen=True)
class _Accepted:
    """A picture that is durable, and how long that took."""

    kept: Submitted
    began: float
    timing: dict[str, float]


class Recogniser:
    """What revisit does for its users.

    Parameters
    ----------
    runtime : Runtime
        Built and started by others.
    explanations : Explanations
        Where the latest explained queries are kept.
    """

    def __init__(self, runtime: Runtime, explanations: Explanations) -> None:
        self._runtime = runtime
        self._store = runtime.store
        self._settled = Waiter(runtime.store)
        self._explanations = explanations
        if runtime.loop is not None:
            runtime.loop.on_finish(self._settled.notify)

    # enrolment

    async def enroll(
        self, images: Sequence[tuple[str | None, bytes]], map_name: str, attributes: ViewAttributes, wait: bool
    ) -> list[wire.Enrolled | RevisitError]:
        """Keep pictures and describe them.

        Parameters
        ----------
        images : sequence of (file name or None, bytes)
        map_name : str
            Made when there is none.
        attributes : ViewAttributes
        wait : bool
            False answers as soon as the picture is durable.

        Returns
        -------
        list
            For each picture, in order, what came of it or why it was refused. A refused picture left nothing behind,
            except one without static content: it is kept, `failed`.
        """
        submitted = [await self._submit(data, map_name, attributes) for _, data in images]
        return [s if isinstance(s, RevisitError) else await self._outcome(s, wait) for s in submitted]

    async def _submit(self, data: bytes, map_name: str, attributes: ViewAttributes) -> _Accepted | RevisitError:
        try:
            accepted = await asyncio.to_thread(self._keep, data, map_name, attributes)
        except RevisitError as error:
            return error
        if self._runtime.loop is not None and accepted.kept.job_id is not None:
            self._runtime.loop.wake()
        return accepted

    def _keep(self, data: bytes, map_name: str, attributes: ViewAttributes) -> _Accepted:
        began = time.perf_counter()
        image = self._runtime.decode(data)
        decoded = time.perf_counter()
        waiting = self._store.waiting()
        if waiting >= self._runtime.settings.queue:
            raise Busy.queue(waiting, self._runtime.scheduler.pace_s, "enrolments")
        facts = ImageFacts(image.width, image.height, image.byte_count, image.format, image.digest)
        kept = self._store.submit(map_name, data, facts, attributes, self._runtime.default_recipe, _now())
        return _Accepted(kept, began, {"decode": (decoded - began) * 1000, "store": _since(decoded)})

    async def _outcome(self, accepted: _Accepted, wait: bool) -> wire.Enrolled | RevisitError:
        kept = accepted.kept
        record = kept.view
        if wait and kept.job_id is not None:
            describing = time.perf_counter()
            record = await self._settled.wait(record.id, PATIENCE_S)
            accepted.timing["describe"] = _since(describing)
            if record.state == "failed" and record.failure is not None:
                code, detail = record.failure
                if code == NothingStatic.code:
                    return NothingStatic(f"{detail} (kept as view {record.id}, which no search will return)")
                if kept.created:  # a view that an earlier call acknowledged stays, whatever becomes of this one
                    await asyncio.to_thread(self._store.delete_view, record.id)
                return RevisitError(detail)
        revision = kept.revision
        labels: Sequence[str] = ()  # what is not described yet shows none
        if record.state == "ready":
            owner = await asyncio.to_thread(self._store.map, record.map)
            revision, labels = owner.revision, owner.recipe.labels
        accepted.timing["total"] = _since(accepted.began)
        return wire.Enrolled(
            view=presenters.view(record, labels),
            created=kept.created,
            revision=revision,
            job=kept.job_id if record.state == "pending" else None,
            timing_ms=accepted.timing,
        )

    # queries

    async def query(
        self,
        image: bytes,
        map_name: str,
        *,
        top: int,
        candidates: int | None,
        filters: Filters,
        explain: bool,
        drive: str | None = None,
    ) -> wire.QueryAnswer:
        """Which views of a map show the place of a picture.

        Raises
        ------
        BadImage, NotFound, NothingStatic, Busy
        """
        began = time.perf_counter()
        describer, decoded = await asyncio.to_thread(self._read, map_name, image)
        decode_ms = _since(began)
        timed, answer = await self._ask(decoded, map_name, describer, filters, max(top, COMPARED), candidates)
        description = timed.value
        decision = decide(answer.found, self._runtime.calibration(answer.recipe))
        answer = replace(answer, found=answer.found[:top])
        decision = replace(decision, confidences=decision.confidences[:top])
        query_id = str(uuid7())
        if explain:
            small = await asyncio.to_thread(self._runtime.shrink, decoded)
            self._explanations.keep(query_id, Explained(small, description, answer))
        explained = query_id if explain else None
        return wire.QueryAnswer(
            query=wire.QueryFacts(
                id=query_id,
                width=decoded.width,
                height=decoded.height,
                labels=presenters.label_shares(description.label_shares, answer.recipe.labels),
                static_share=description.static_share,
            ),
            map=map_name,
            revision=answer.revision,
            recipe=answer.recipe.id,
            searched=answer.searched,
            status=decision.status,
            confidence=decision.confidence,
            matches=[
                presenters.match(rank, found, confidence, answer.recipe, description.appearance.graph, explained)
                for rank, (found, confidence) in enumerate(
                    zip(answer.found, decision.confidences, strict=True), start=1
                )
            ],
            estimate=presenters.estimate(answer.found, decision),
            timing_ms={
                "decode": decode_ms,
                "queue": timed.queue_ms,
                "encode": timed.encode_ms,
                "describe": timed.finish_ms,
                **answer.timing_ms,
                "total": _since(began),
            },
        )

    def _read(self, map_name: str, image: bytes) -> tuple[Describer, Image]:
        """What a query needs first; an unknown map is refused before any work is done."""
        return self._describer(map_name), self._runtime.decode(image)

    def _describer(self, map_name: str) -> Describer:
        return self._runtime.describers.of(self._store.map(map_name).recipe)

    async def _ask(
        self, image: Image, map_name: str, describer: Describer, filters: Filters, top: int, candidates: int | None
    ) -> tuple[Timed[Description], Answer]:
        """Describe by the map's recipe and search; anew if the map changed over to another recipe in between."""
        search = self._runtime.searcher.search
        while True:
            handed_in = self._runtime.scheduler.submit(
                image, describer.describe, urgent=True, parallel=describer.keypoints
            )
            timed = await asyncio.wrap_future(handed_in)
            try:
                return timed, await asyncio.to_thread(
                    search, map_name, describer.recipe, timed.value, filters, top, candidates
                )
            except RecipeChanged:
                describer = await asyncio.to_thread(self._describer, map_name)


def _now() -> datetime:
    return datetime.now(UTC)


def _since(moment: float) -> float:
    """Milliseconds since a reading of `time.perf_counter`."""
    return (time.perf_counter() - moment) * 1000
