"""A running service as something to be measured: what `worker.evaluate` asks for, over HTTP."""

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from app.client import Revisit, RevisitProblem
from schemas.errors import RevisitError
from schemas.records import Where
from worker.datasets.dataset import Dataset
from worker.evaluation.asking import Answer, Retriever
from worker.evaluation.contender import Contender


class RemoteRetriever:
    """A map of its own in a running service.

    Parameters
    ----------
    revisit : Revisit
    preset : str
    map_name : str
        New.
    """

    def __init__(self, revisit: Revisit, preset: str, map_name: str) -> None:
        self._revisit, self._map, self.name = revisit, map_name, preset
        # What the service would answer depends on its version too: an answer kept from another one is no answer of it.
        version = revisit.version()
        self.recipe = f"{revisit.put_map(map_name, preset=preset).recipe['id']} {version.version} {revisit.url}"

    def enroll(self, picture: Path, where: Where) -> str:
        """Enrol a picture and wait until it is searchable; raises RevisitError when it is refused."""
        try:
            return self._revisit.enroll(picture, map=self._map, x=where.x, y=where.y).view.id
        except RevisitProblem as refusal:
            raise _refused(refusal) from refusal

    def query(self, picture: Path, top: int) -> Answer:
        """Ask twice: as users do, and by the histograms alone."""
        try:
            answer = self._revisit.query(picture, map=self._map, top=top)
            plain = self._revisit.query(picture, map=self._map, top=top, candidates=0)
        except RevisitProblem as refusal:
            raise _refused(refusal) from refusal
        return Answer(
            views=tuple(match.view.id for match in answer.matches),
            before=tuple(match.view.id for match in plain.matches),
            scores=tuple(match.score for match in answer.matches),
            confidence=answer.confidence,
            status=answer.status,
            timing_ms=answer.timing_ms,
        )


def contender(url: str, preset: str) -> Contender:
    """A preset of the service at a URL."""
    return Contender(partial(_map_of_its_own, url, preset))


@contextmanager
def _map_of_its_own(url: str, preset: str, dataset: Dataset) -> Iterator[Retriever]:
    """A retriever on a new map, which is deleted afterwards."""
    map_name = f"evaluation-{uuid.uuid4().hex[:12]}"
    with Revisit(url) as revisit:
        try:
            yield RemoteRetriever(revisit, preset, map_name)
        finally:
            revisit.delete_map(map_name)


def _refused(problem: RevisitProblem) -> RevisitError:
    refusal = RevisitError(str(problem))
    refusal.code = problem.code
    return refusal
