"""The latest explained queries, so that their explanation can be drawn when somebody wants to see it."""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import Description
from schemas.errors import NotFound
from schemas.image import Image
from worker.images import drawing
from worker.search.searcher import Answer, ScoredView

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Explained:
    """What drawing an explanation takes.

    Parameters
    ----------
    image : Image
        Made small; explanations are drawn at this size.
    """

    image: Image
    description: Description
    answer: Answer

    def draw(self, found: ScoredView, view: Image) -> bytes:
        """Query and match side by side: keypoints that agree, nodes that correspond, and what each term adds."""
        labels, query = self.answer.recipe.labels, self.description.appearance.graph
        nodes: list[tuple[str, Point, Point]] = []
        if found.graph is not None:
            nodes = [
                (labels[query.labels[p]], _point(query.positions[p]), _point(found.graph.view.positions[r]))
                for p, r in found.graph.pairs
            ]
        inliers: list[tuple[Point, Point]] = []
        text = [f"score {found.score:.3f}"]
        text += [f"{term} {part:.3f}" for term, part in sorted(found.parts.items())]
        if found.verified is not None:
            inliers = [(_point(pair[:2]), _point(pair[2:])) for pair in found.verified.pairs]
            text.append(f"{found.verified.inliers} of {found.verified.matches} keypoints agree")
        return drawing.explanation_png(self.image.pixels, view.pixels, inliers, nodes, text)

    def match(self, view_id: str | None) -> ScoredView:
        """The match with that view, or the first one; raises NotFound."""
        for found in self.answer.found:
            if view_id is None or found.view.id == view_id:
                return found
        raise NotFound("match", view_id or "1", "the query has no such match")


class Explanations:
    """Keeps the `most` latest explained queries.

    Parameters
    ----------
    most : int
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[str, Explained] = OrderedDict()

    def keep(self, query_id: str, explained: Explained) -> None:
        """Remember one, and forget the oldest beyond the bound."""
        self._kept[query_id] = explained
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)

    def get(self, query_id: str) -> Explained:
        """One of the latest; raises NotFound."""
        try:
            return self._kept[query_id]
        except KeyError:
            raise NotFound(
                "explained query", query_id, f"ask with explain=true; the latest {self._most} are kept until a restart"
            ) from None


def _point(position: npt.NDArray[np.floating]) -> Point:
    return float(position[0]), float(position[1])
