"""The latest explained queries, kept in memory so that their explanations can be drawn on demand."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import Description
from schemas.errors import NotFound
from schemas.image import Image
from schemas.latest import Latest
from schemas.recipe import MapRecipe
from worker.images.explanation import Headline
from worker.method.camera_fixed import CameraFixed
from worker.method.decision import Decision
from worker.service.results import RankedResults, ScoredView

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Explained:
    """All that the explanation of a query is drawn from.

    Parameters
    ----------
    image : Image
        The query image as it was compared, shrunk; explanations are drawn at this size.
    description : Description
        Of the query image.
    views : tuple of ScoredView
        Those that may be shown, best first.
    recipe : MapRecipe
    fixed : tuple of CameraFixed
        What is fixed to the maps' cameras.
    headline : Headline
        The verdict in words.
    rival : ScoredView or None
        The view that the first match is compared with; it need not be among the results.
    maps : tuple of str
        Names of all maps that were searched for it; any of them may be shown. Needed of one that is kept.
    photo : Image or None
        The query image as it was sent, shrunk, where it was compared otherwise: changes are looked for in it.
    """

    image: Image
    description: Description
    views: tuple[ScoredView, ...]
    recipe: MapRecipe
    fixed: tuple[CameraFixed, ...]
    headline: Headline
    rival: ScoredView | None = None
    maps: tuple[str, ...] = ()
    photo: Image | None = None

    @classmethod
    def of(
        cls,
        image: Image,
        description: Description,
        results: RankedResults,
        headline: Headline,
        rival: ScoredView | None = None,
        maps: tuple[str, ...] = (),
        top: int | None = None,
    ) -> "Explained":
        """Of what a search found, what its first `top` views are drawn from.

        The results themselves hold the evidence of all candidates: as much memory as the image.
        """
        return cls(image, description, results.views[:top], results.recipe, results.fixed, headline, rival, maps)

    def view(self, view_id: str | None) -> ScoredView:
        """The result for a view, or the first result when `view_id` is None; raises NotFound."""
        for scored in self.views:
            if view_id is None or scored.view.id == view_id:
                return scored
        raise NotFound("match", view_id or "1", "the query has no such match")

    def rank(self, scored: ScoredView) -> int:
        """Rank of a result, from 1."""
        return 1 + [one.view.id for one in self.views].index(scored.view.id)

    def is_first(self, scored: ScoredView) -> bool:
        """Whether a result is the first match."""
        return scored.view.id == self.views[0].view.id

    def compared_with(self, scored: ScoredView) -> ScoredView | None:
        """The view that a result is compared with: for the first match the rival, for any other the first match."""
        return self.rival if self.is_first(scored) else self.views[0]


def headline(decision: Decision) -> Headline:
    """The verdict on an answer in words."""
    code, detail = decision.reason.code, decision.reason.detail
    return Headline(decision.status, decision.confidence, f"{code}: {detail}.")


class Explanations:
    """Keeps the latest explained queries.

    Parameters
    ----------
    most : int
        Number of queries kept; the oldest is forgotten first.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._kept: Latest[str, Explained] = Latest(most)

    def keep(self, query_id: str, explained: Explained) -> None:
        """Keep an explained query, and forget the oldest ones beyond `most`."""
        self._kept[query_id] = explained

    def get(self, query_id: str) -> Explained:
        """An explained query by its id; raises NotFound."""
        try:
            return self._kept[query_id]
        except KeyError:
            raise NotFound(
                "explained query",
                query_id,
                f"query with explain=true; the latest {self.most} are kept until a restart (REVISIT_EXPLANATIONS)",
            ) from None


def point(position: npt.NDArray[np.floating]) -> Point:
    """(x, y) as plain numbers."""
    return float(position[0]), float(position[1])
