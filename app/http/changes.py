"""Changes of a whole map in the background: another recipe, or a vocabulary of its own."""

import logging
import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np
from uuid6 import uuid7

from schemas import wire
from schemas.description import PixelField
from schemas.errors import Conflict, RevisitError
from schemas.recipe import Recipe
from schemas.records import Filters
from worker.description import vocabularies
from worker.description.presets import make_recipe
from worker.runtime import Runtime

log = logging.getLogger("revisit.changes")

KEPT = 200
"""Changes whose progress can still be asked for. What they did is durable; their record lasts until a restart."""

PAGE = 500


@dataclass
class _Change:
    id: str
    kind: Literal["recipe", "vocabulary"]
    map: str
    began: datetime
    target: str | None = None
    failure: tuple[str, str] | None = None


class Changes:
    """Begins changes and tells how far they are.

    Parameters
    ----------
    runtime : Runtime
    """

    def __init__(self, runtime: Runtime) -> None:
        self._runtime = runtime
        self._kept: OrderedDict[str, _Change] = OrderedDict()
        self._lock = threading.Lock()

    def switch(self, name: str, wanted: wire.PutMap) -> wire.Job:
        """Describe a map's views by another recipe; the old one answers until the last view is done.

        What `wanted` leaves out stays as the map has it, unless it names another preset or the map was made with
        another encoder.

        Raises
        ------
        NotFound, Conflict, InvalidParameters
        """
        present = self._runtime.store.map(name).recipe
        encoder = self._runtime.encoder
        own = (present.encoder, present.weights) == (encoder.name, encoder.digest)
        same = own and wanted.preset in (None, present.preset)
        labels = list(present.labels) if wanted.labels is None and same else wanted.labels
        dynamic = wanted.dynamic
        if dynamic is None and same:
            dynamic = [word for word in present.dynamic if labels is None or word in labels]
        recipe = make_recipe(
            encoder,
            wanted.preset or present.preset,
            labels=labels,
            dynamic=dynamic,
            parameters=wanted.parameters,
            vocabulary=self._runtime.describers.of(present).vocabulary if same else None,
            present=present.parameters if same else None,
        )
        change = self._record("recipe", name)
        self._begin(change, recipe)
        return self._job(change)

    def train(self, name: str) -> wire.Job:
        """Train a vocabulary on a map's own views, then describe them by it.

        Raises
        ------
        NotFound
            There is no such map.
        Conflict
            A vocabulary of this map is being trained already.
        """
        self._runtime.store.map(name)
        with self._lock:
            if any(c.kind == "vocabulary" and c.map == name and c.target is None and c.failure is None
                   for c in self._kept.values()):  # fmt: skip
                raise Conflict(f"a vocabulary for the map {name!r} is being trained already; wait for that job")
        change = self._record("vocabulary", name)
        threading.Thread(target=self._train, args=(change,), name="revisit-vocabulary", daemon=True).start()
        return self._job(change)

    def job(self, job_id: str) -> wire.Job | None:
        """How far a change is; None when it is not one of ours."""
        change = self._kept.get(job_id)
        return None if change is None else self._job(change)

    def _record(self, kind: Literal["recipe", "vocabulary"], name: str) -> _Change:
        change = _Change(str(uuid7()), kind, name, datetime.now(UTC))
        with self._lock:
            self._kept[change.id] = change
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return change

    def _begin(self, change: _Change, recipe: Recipe) -> None:
        self._runtime.store.switch_recipe(change.map, recipe, datetime.now(UTC))
        change.target = recipe.id
        if self._runtime.loop is not None:
            self._runtime.loop.wake()

    def _train(self, change: _Change) -> None:
        try:
            recipe = self._runtime.store.map(change.map).recipe
            describer = self._runtime.describers.of(recipe)
            learned = vocabularies.train(
                self._fields(change.map, recipe.parameters.seed),
                lambda field: describer.see(field).static,
                recipe.parameters,
                recipe.parameters.seed,
            )
            self._runtime.store.keep_vocabulary(learned.digest, learned.tensors)
            self._begin(change, recipe.model_copy(update={"vocabulary": learned.digest}))
        except ValueError as error:
            change.failure = "too-few-pictures", f"{error}; enrol more views of different places first"
        except RevisitError as error:
            change.failure = error.code, error.detail
        except Exception as error:
            log.exception("training a vocabulary for the map %s failed", change.map)
            change.failure = "internal", f"{type(error).__name__}; the service's log has the details"

    def _fields(self, name: str, seed: int) -> Iterator[PixelField]:
        """Fields of the map's views, in a random order that the seed decides; behind all queries."""
        ids: list[str] = []
        cursor: str | None = None
        while True:
            page, cursor = self._runtime.store.views(name, Filters(), state="ready", cursor=cursor, limit=PAGE)
            ids += [view.id for view in page]
            if cursor is None:
                break
        for number in np.random.default_rng(seed).permutation(len(ids))[: vocabularies.MOST_IMAGES]:
            image = self._runtime.decode(self._runtime.store.image(ids[number]))
            yield self._runtime.scheduler.submit(image, lambda _, field: field, urgent=False).result().value

    def _job(self, change: _Change) -> wire.Job:
        state: Literal["running", "done", "failed"] = "running"
        if change.failure is not None:
            state = "failed"
        elif change.target is not None and self._runtime.store.map(change.map).recipe.id == change.target:
            state = "done"
        return wire.Job(
            id=change.id,
            kind=change.kind,
            state=state,
            map=change.map,
            view=None,
            attempts=1,
            created_at=change.began,
            finished_at=None,
            failure=None if change.failure is None else wire.Failure(code=change.failure[0], detail=change.failure[1]),
            links={"self": f"/jobs/{change.id}", "map": f"/maps/{change.map}"},
        )
