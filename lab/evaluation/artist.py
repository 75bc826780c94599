"""Draws for the report what the method saw: labels, context graphs, and what corresponds."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from lab.evaluation.html import Shown
from lab.evaluation.service import ServiceRetriever
from schemas.description import Floats, PixelField
from schemas.errors import RevisitError
from schemas.image import Image
from schemas.records import Position
from worker.description.describer import Describer
from worker.images import drawing

EXPLAINED = 100
"""Answers among which the one to be explained is looked for."""


class ServiceArtist:
    """Draws what a house saw.

    Parameters
    ----------
    retriever : ServiceRetriever
    """

    def __init__(self, retriever: ServiceRetriever) -> None:
        self.retriever, self.runtime = retriever, retriever.runtime

    def explain(self, query: Path, answer: Path) -> Sequence[Shown]:
        """Both context graphs, and what corresponds between the query and that answer."""
        one, other = (self.runtime.decode(path.read_bytes()) for path in (query, answer))
        shown = [Shown("context graph of the query", self._graph(one)), Shown("of the answer", self._graph(other))]
        # A run that was only read back from its journal has enrolled nothing. Where the picture is in the map already,
        # with its position, it is refused, which is as well.
        with suppress(RevisitError):
            self.retriever.enroll(answer, Position())
        searched = self.retriever.ask(one, EXPLAINED)
        match = next((f for f in searched.answer.found if f.view.image.sha256 == other.digest), None)
        if match is None:
            return shown
        graph, own = match.graph, searched.timed.value.appearance.graph
        words = self.retriever.settings.labels
        nodes = (
            [(words[own.labels[p]], _point(own.positions[p]), _point(graph.view.positions[r])) for p, r in graph.pairs]
            if graph
            else []
        )
        inliers = [((a, b), (c, d)) for a, b, c, d in match.verified.pairs.tolist()] if match.verified else []
        parts = ", ".join(f"{name} {value:.2f}" for name, value in match.parts.items())
        attributes = [f"score {match.score:.3f} = {parts}", f"{len(nodes)} node pairs, {len(inliers)} keypoints agree"]
        drawn = drawing.explanation_png(one.pixels, other.pixels, inliers, nodes, attributes)
        return [*shown, Shown("what agrees: nodes (thick, by word) and keypoints (thin, green)", drawn, wide=True)]

    def portray(self, image: Path) -> Sequence[Shown]:
        """Labels, with what moves in grey, and the method's nodes."""
        one = self.runtime.decode(image.read_bytes())
        words = self.retriever.settings.labels

        def draw(pixels: Image, field: PixelField) -> bytes:
            seen = self._describer().see(field)
            return drawing.overlay_png(pixels.pixels, seen.labels, words, seen.static)

        overlay = self.runtime.scheduler.submit(one, draw, urgent=True, fine=True).result().value
        return [
            Shown("segmentation by words; what moves is grey", overlay),
            Shown("where the method puts its own: nodes of static regions", self._graph(one)),
        ]

    def _describer(self) -> Describer:
        return self.runtime.describers.of(self.retriever.settings)

    def _graph(self, image: Image) -> bytes:
        describer, recipe = self._describer(), self.retriever.settings

        def draw(pixels: Image, field: PixelField) -> bytes:
            graph = describer.graph(field, describer.segment(field))
            return drawing.graph_png(pixels.pixels, graph, recipe.labels, recipe.parameters.graph.tau)

        return self.runtime.scheduler.submit(image, draw, urgent=True).result().value


def _point(position: Floats) -> tuple[float, float]:
    return float(position[0]), float(position[1])
