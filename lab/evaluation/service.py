"""The service in this process as something to be measured: its store, its desk and its search, without HTTP."""

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from lab.datasets.dataset import Dataset
from lab.evaluation.querying import Answer, Retriever
from schemas.description import Description
from schemas.errors import RevisitError
from schemas.image import Image, ImageFacts
from schemas.recipe import Recipe
from schemas.records import Filters, Position, ViewAttributes
from worker.description.scheduler import Timed
from worker.method.decision import decide, features
from worker.runtime import Runtime
from worker.search.searcher import Answer as Ranked

LOOK_AGAIN_S = 0.25
"""How long to wait for the worker's word before looking for oneself."""

_numbers = count()


@dataclass(frozen=True, eq=False)
class QueryRecord:
    """What the house made of a query."""

    timed: Timed[Description]
    answer: Ranked


class ServiceRetriever:
    """A map of its own in a house that has been started.

    Parameters
    ----------
    runtime : Runtime
        Built by `worker.bootstrap`, with a worker of its own.
    recipe : Recipe
        Of the map.
    name : str
        In tables.
    map_name : str
        New.
    """

    def __init__(self, runtime: Runtime, recipe: Recipe, name: str, map_name: str) -> None:
        if runtime.loop is None:
            raise ValueError("a house without a worker describes nothing")
        self.runtime, self.settings, self.name, self.map_name = runtime, recipe, name, map_name
        runtime.store.put_map(map_name, recipe, datetime.now(UTC))
        self._settled = threading.Event()
        self._loop = runtime.loop
        self._loop.on_finish(lambda _: self._settled.set())

    @property
    def recipe(self) -> str:
        """Id of the map's recipe, and how its confidences are made."""
        return f"{self.settings.id} {self.runtime.calibration(self.settings).to_json()}"

    def enroll(self, image: Path, position: Position) -> str:
        """Keep a picture and wait until it is described; raises RevisitError when it cannot be."""
        data = image.read_bytes()
        decoded = self.runtime.decode(data)
        facts = ImageFacts(decoded.width, decoded.height, decoded.byte_count, decoded.format, decoded.digest)
        store = self.runtime.store
        kept = store.submit(
            self.map_name, data, facts, ViewAttributes(position=position), self.settings, datetime.now(UTC)
        )
        view = kept.view
        self._loop.wake()
        while view.state == "pending":
            self._settled.wait(LOOK_AGAIN_S)
            self._settled.clear()
            view = store.view(view.id)
        if view.failure is not None:
            refusal = RevisitError(view.failure[1])
            refusal.code = view.failure[0]
            raise refusal
        return view.id

    def query(self, image: Path, top: int) -> Answer:
        """Ask; the histograms alone are searched a second time with the same description."""
        began = time.perf_counter()
        decoded = self.runtime.decode(image.read_bytes())
        decode_ms = (time.perf_counter() - began) * 1000
        results = self.ask(decoded, top)
        total_ms = (time.perf_counter() - began) * 1000
        found = results.answer.found
        decision = decide(found, self.runtime.calibration(results.answer.recipe))
        plain = self._search(results.timed.value, top, 0)
        timing: Mapping[str, float] = {
            "decode": decode_ms,
            "encode": results.timed.encode_ms,
            "describe": results.timed.finish_ms,
            **results.answer.timing_ms,
            "total": total_ms,
        }
        return Answer(
            views=tuple(f.view.id for f in found),
            before=tuple(f.view.id for f in plain.found),
            scores=tuple(f.score for f in found),
            confidence=decision.confidence,
            status=decision.status,
            timing_ms=timing,
            features={name: float(values[0]) for name, values in features(found).items()} if found else {},
        )

    def ask(self, image: Image, top: int) -> QueryRecord:
        """Describe and search, with everything that the search saw."""
        describer = self.runtime.describers.of(self.settings)
        timed = self.runtime.scheduler.submit(
            image, describer.describe, urgent=True, parallel=describer.keypoints
        ).result()
        return QueryRecord(timed, self._search(timed.value, top, None))

    def _search(self, description: Description, top: int, candidates: int | None) -> Ranked:
        return self.runtime.searcher.search(self.map_name, self.settings, description, Filters(), top, candidates)


@contextmanager
def map_of_its_own(runtime: Runtime, recipe: Recipe, name: str, dataset: Dataset) -> Iterator[Retriever]:
    """A retriever on a new map, which is deleted afterwards."""
    map_name = f"evaluation-{next(_numbers)}"
    try:
        yield ServiceRetriever(runtime, recipe, name, map_name)
    finally:
        runtime.store.delete_map(map_name)
