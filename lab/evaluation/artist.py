"""Draws for the report what the service saw: labels, context graphs, and what corresponds."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from lab.evaluation.html import Shown
from lab.evaluation.service import ServiceRetriever
from worker.images.codec import shrink
from worker.service.explanations import Explained, headline

EXPLAINED = 100
"""Answers among which the one to be explained is looked for."""


KEPT = "of the answer; it was kept by an earlier run: one with another --out draws what agrees"


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
        """Both context graphs, and what corresponds between the query and that answer.

        A run whose answers were kept by an earlier one has enrolled nothing. A map of this answer alone would decide
        otherwise, and tell of a certainty that there was not: then the graphs are drawn alone, which is said.
        """
        one, other = (self._decode(path.read_bytes()) for path in (query, answer))
        shown = [
            Shown("context graph of the query", self._draw.draw_graph(one, self._owner)),
            Shown("of the answer", self._draw.draw_graph(other, self._owner)),
        ]
        result = self._retriever.result(query, EXPLAINED)
        if not result.results.views:
            return [shown[0], replace(shown[1], caption=KEPT)]
        scored = next((v for v in result.results.views if v.view.image.sha256 == other.digest), None)
        if scored is None:
            return shown
        explained = Explained.of(
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
