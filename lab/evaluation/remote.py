"""A service behind a URL as something to be measured, through the client."""

import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from revisit_client import ClientError, JobFailed, Revisit, RevisitProblem
from revisit_client.wire import MapFacts

from lab.datasets.dataset import Dataset
from lab.evaluation.contender import Contender
from lab.evaluation.querying import PATIENCE_S, Answer
from schemas.errors import RevisitError
from schemas.records import Position


class ServedRetriever:
    """A map of its own in a running service.

    Parameters
    ----------
    revisit : Revisit
    facts : MapFacts
        Of the map, which is empty.
    name : str
        In tables.
    """

    def __init__(self, revisit: Revisit, facts: MapFacts, name: str) -> None:
        self._revisit, self._map, self.name = revisit, facts.name, name
        self.recipe = f"{facts.recipe['id']} {facts.ranking['id']} {revisit.version().version}"

    def enroll(self, image: Path, position: Position) -> str:
        """Enrol and wait until it is searchable; raises RevisitError as the service refused.

        The service itself waits so long as it is told to (`REVISIT_WAIT`), and with a slow encoder answers before.
        """
        try:
            enrolled = self._revisit.enroll(
                image,
                map=self._map,
                x=position.x,
                y=position.y,
                z=position.z,
                lat=position.lat,
                lon=position.lon,
                alt=position.alt,
            )
            if enrolled.job is not None:
                self._revisit.wait_for_job(enrolled.job, timeout=PATIENCE_S)
        except RevisitProblem as problem:
            raise _refusal(problem) from problem
        except JobFailed as failed:
            reason = failed.job.failure
            refusal = RevisitError(str(failed))
            refusal.code = refusal.code if reason is None else reason.code
            raise refusal from failed
        except TimeoutError as error:
            raise RevisitError(f"{image} is not described yet: {error}") from None
        return enrolled.view.id

    def query(self, image: Path, top: int) -> Answer:
        """Query twice: as usual, and by the histograms alone."""
        try:
            answer = self._revisit.query(image, map=self._map, top=top)
            plain = self._revisit.query(image, map=self._map, top=top, candidates=0)
        except RevisitProblem as problem:
            raise _refusal(problem) from problem
        return Answer(
            views=tuple(match.view.id for match in answer.matches),
            before=tuple(match.view.id for match in plain.matches),
            scores=tuple(match.score for match in answer.matches),
            confidence=answer.confidence,
            status=answer.status,
            timing_ms=answer.timing_ms,
        )


def connect(url: str, preset: str) -> Contender:
    """A preset of a running service as something to be measured."""
    return Contender(partial(_map_of_its_own, url, preset))


@contextmanager
def _map_of_its_own(url: str, preset: str, dataset: Dataset) -> Iterator[ServedRetriever]:
    """A map that nobody else uses, removed afterwards; where that fails, it is said what is left."""
    with Revisit(url) as revisit:
        facts = revisit.put_map(f"evaluation-{uuid.uuid4().hex[:12]}", preset=preset)
        try:
            yield ServedRetriever(revisit, facts, preset)
        finally:
            try:
                revisit.delete_map(facts.name)
            except ClientError as error:
                left = f"the map {facts.name} is left there: `./revisit maps {facts.name} --delete`"
                print(f"{url}: {error}; {left}", file=sys.stderr)


def _refusal(problem: RevisitProblem) -> RevisitError:
    refusal = RevisitError(problem.detail)
    refusal.code = problem.code
    return refusal
