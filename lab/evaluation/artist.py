"""Draws for the report what the service saw: labels, context graphs, and what corresponds."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from lab.evaluation.html import Shown
from lab.evaluation.service import ServiceRetriever
from schemas.errors import RevisitError
from schemas.records import Position
from worker.images.codec import shrink
from worker.service.explanations import Explained, headline

EXPLAINED = 100
"""Answers among which the one to be explained is looked for."""


class ServiceArtist:
    """Draws by the recipe of a retriever's map.

    Parameters
    ----------
    retriever : ServiceRetriever
    """

    def __init__(self, retriever: ServiceRetriever) -> None:
        self._retriever = retriever
        self._decode, self._draw = retriever.runtime.decode, retriever.runtime.services.renderings
        self._owner = retriever.runtime.store.maps.get(retriever.map_name)

    def explain(self, query: Path, answer: Path) -> Sequence[Shown]:
        """Both context graphs, and what corresponds between the query and that answer."""
        one, other = (self._decode(path.read_bytes()) for path in (query, answer))
        shown = [
            Shown("context graph of the query", self._draw.draw_graph(one, self._owner)),
            Shown("of the answer", self._draw.draw_graph(other, self._owner)),
        ]
        # A run that was only read back from its journal has enrolled nothing. Where the image is in the map already,
        # with its position, it is refused, which is as well.
        with suppress(RevisitError):
            self._retriever.enroll(answer, Position())
        result = self._retriever.result(query, EXPLAINED)
        scored = next((v for v in result.results.views if v.view.image.sha256 == other.digest), None)
        if scored is None:
            return shown
        explained = Explained(
            shrink(one), result.description, result.results, headline(result.decision), result.results.rival
        )
        drawn = self._draw.draw_explanation(explained, scored)
        return [*shown, Shown("what agrees, and decided: cells, keypoints and regions", drawn, wide=True)]

    def portray(self, image: Path) -> Sequence[Shown]:
        """Labels, with dynamic things in grey, and the context graph."""
        one = self._decode(image.read_bytes())
        return [
            Shown("segmentation by labels; what moves is grey", self._draw.draw_overlay(one, self._owner, legend=True)),
            Shown("nodes of static regions: the context graph", self._draw.draw_graph(one, self._owner)),
        ]
