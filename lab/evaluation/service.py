"""The service in this process as something to be measured: its use-cases, without HTTP."""

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from functools import lru_cache
from itertools import count
from pathlib import Path

import schemas
import worker
from lab.datasets.dataset import Dataset, digest
from lab.evaluation.querying import PATIENCE_S, Answer
from schemas.recipe import MapRecipe
from schemas.records import Filters, Position, ViewAttributes
from worker.runtime import Runtime
from worker.service.query import QueryResult
from worker.service.query_options import QueryOptions

ROOMS = tuple(Path(room.__path__[0]) for room in (schemas, worker))
"""Folders of the program that decides answers."""

PROGRAM = frozenset({".py", ".json", ".onnx", ".safetensors"})
"""Endings of its files."""

_numbers = count()


class ServiceRetriever:
    """A map of its own in a runtime that has been started.

    Parameters
    ----------
    runtime : Runtime
        Built by `worker.runtime`, with a worker of its own.
    recipe : MapRecipe
        Of the map.
    name : str
        In tables.
    map_name : str
        New.

    Attributes
    ----------
    options : QueryOptions
        What each query asks for, whose `top` is the call's.
    """

    def __init__(self, runtime: Runtime, recipe: MapRecipe, name: str, map_name: str) -> None:
        if runtime.loop is None:
            raise ValueError("a runtime without a worker describes nothing")
        self.runtime, self.map_recipe, self.name, self.map_name = runtime, recipe, name, map_name
        self.options = QueryOptions()
        self._compared = False
        runtime.store.maps.put(map_name, recipe, datetime.now(UTC))

    @property
    def recipe(self) -> str:
        """Id of both halves of the map's recipe, how its confidences are made, and the program that does it."""
        calibration = self.runtime.calibration(self.map_recipe).to_json()
        return f"{self.map_recipe.description.id} {self.map_recipe.ranking.id} {calibration} {program()}"

    def enroll(self, image: Path, position: Position, place: str | None = None) -> str:
        """Enrol an image and wait until it is described; raises RevisitError when it cannot be."""
        self._compared = False
        service = self.runtime.services.enroll
        attributes = ViewAttributes(place=place, position=position)
        outcome = service.enroll(image.read_bytes(), self.map_name, attributes, patience_s=PATIENCE_S)
        return outcome.view.id

    def query(self, image: Path, top: int) -> Answer:
        """Query; the histograms alone are searched a second time with the same description."""
        result = self.result(image, top)
        results = result.results
        plain = self.runtime.services.searcher.search(
            {self.map_name: Filters()}, results.recipe.description, result.description, top=top, candidates=0
        )
        found = results.views[:top]
        return Answer(
            views=tuple(scored.view.id for scored in found),
            before=tuple(scored.view.id for scored in plain.views[:top]),
            scores=tuple(scored.score for scored in found),
            confidence=result.decision.confidence,
            status=result.decision.status,
            timing_ms=result.timing_ms,
            features=evidence(result),
        )

    def result(self, image: Path, top: int) -> QueryResult:
        """The whole result of a query, with everything that the search saw.

        Before the first one, the views of the map are compared with one another, as the service does in the background.
        """
        if not self._compared:
            self.runtime.comparer.all()
            self._compared = True
        options = replace(self.options, top=top)
        return self.runtime.services.query.query(image.read_bytes(), self.map_name, options=options)


def evidence(result: QueryResult) -> dict[str, float]:
    """What a calibration may read of the first answer; empty without one."""
    decision, results = result.decision, result.results
    if not results.views:
        return {}
    measured = {
        "score": results.views[0].score,
        "rival_score": 0.0 if results.rival is None else results.rival.score,
        "others": float(results.ranking.others),
        "wrong_score": decision.levels.level,
        "wrong_gap": decision.levels.gap,
        "wrong_breadth": decision.levels.breadth or 0.0,
        "own_score": decision.levels.own or 0.0,
        "rival_inliers": float(results.ranking.rival_inliers or 0),
    }
    return {**decision.features, **measured}


@lru_cache
def program(rooms: Sequence[Path] = ROOMS) -> str:
    """16 hex digits that change with the code below some folders, and with what ships there: answers of a method that
    was changed since are not its own."""
    files = (path for room in rooms for path in sorted(room.rglob("*")) if path.suffix in PROGRAM)
    return hashlib.sha256("".join(f"{path.name} {digest(path)}\n" for path in files).encode()).hexdigest()[:16]


@contextmanager
def map_of_its_own(runtime: Runtime, recipe: MapRecipe, name: str, dataset: Dataset) -> Iterator[ServiceRetriever]:
    """A retriever on a new map, which is deleted afterwards."""
    map_name = f"evaluation-{next(_numbers)}"
    try:
        yield ServiceRetriever(runtime, recipe, name, map_name)
    finally:
        runtime.services.maps.delete(map_name)
