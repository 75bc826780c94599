"""The latest explained queries, kept in memory so that their explanations can be drawn on demand."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import ContextGraph, Description
from schemas.errors import NotFound
from schemas.image import Image
from worker.images import drawing
from worker.method.cascade import RankedCandidate
from worker.service.results import RankedResults, ScoredView

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Explained:
    """All that the explanation of a query is drawn from.

    Parameters
    ----------
    image : Image
        The query image, shrunk; explanations are drawn at this size.
    description : Description
        Of the query image.
    results : RankedResults
    """

    image: Image
    description: Description
    results: RankedResults

    def view(self, view_id: str | None) -> ScoredView:
        """The result for a view, or the first result when `view_id` is None; raises NotFound."""
        for scored in self.results.views:
            if view_id is None or scored.view.id == view_id:
                return scored
        raise NotFound("match", view_id or "1", "the query has no such match")

    def draw(self, scored: RankedCandidate, view: Image) -> bytes:
        """Query and view side by side, as PNG; see `draw_explanation`."""
        graph, labels = self.description.appearance.graph, self.results.recipe.description.labels
        return draw_explanation(self.image, view, graph, scored, labels)


def draw_explanation(
    query: Image, view: Image, graph: ContextGraph, scored: RankedCandidate, labels: Sequence[str]
) -> bytes:
    """Query and view side by side, as PNG: inlier keypoints, corresponding nodes, and the parts of the score.

    Parameters
    ----------
    query, view : Image
    graph : ContextGraph
        Of the query image.
    scored : RankedCandidate
        Score, parts and evidence of the view.
    labels : sequence of str
        Label set of the recipe.
    """
    nodes: list[tuple[str, Point, Point]] = []
    if scored.graph is not None:
        nodes = [
            (labels[graph.labels[p]], point(graph.positions[p]), point(scored.graph.view.positions[r]))
            for p, r in scored.graph.pairs
        ]
    inliers: list[tuple[Point, Point]] = []
    text = [f"score {scored.score:.3f}"]
    text += [f"{term} {part:.3f}" for term, part in sorted(scored.parts.items())]
    if scored.verified is not None:
        inliers = [(point(pair[:2]), point(pair[2:])) for pair in scored.verified.pairs]
        text.append(f"{scored.verified.inliers} of {scored.verified.matches} keypoints agree")
    return drawing.explanation_png(query.pixels, view.pixels, inliers, nodes, text)


class Explanations:
    """Keeps the latest explained queries.

    Parameters
    ----------
    most : int
        Number of queries kept; the oldest is forgotten first.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[str, Explained] = OrderedDict()

    def keep(self, query_id: str, explained: Explained) -> None:
        """Keep an explained query, and forget the oldest ones beyond `most`."""
        self._kept[query_id] = explained
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)

    def get(self, query_id: str) -> Explained:
        """An explained query by its id; raises NotFound."""
        try:
            return self._kept[query_id]
        except KeyError:
            raise NotFound(
                "explained query",
                query_id,
                f"query with explain=true; the latest {self._most} are kept until a restart",
            ) from None


def point(position: npt.NDArray[np.floating]) -> Point:
    """(x, y) as plain numbers."""
    return float(position[0]), float(position[1])
