"""What a map answers to a description by one recipe: search, ranking and verdict, with nothing described for it."""

from dataclasses import dataclass

from schemas.comparisons import MapLevels
from schemas.description import Description
from schemas.recipe import MapRecipe
from schemas.records import Selection
from worker.method import cascade
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.method.decision import GROUPED, Decision, decide
from worker.method.evidence import Ranking
from worker.method.impostors import Impostors
from worker.search.fetcher import Fetcher
from worker.search.ports import SearchableIndex

ROUNDS = 5
"""Attempts at an answer; one is repeated when a view that was found is deleted before it is ranked."""


@dataclass(frozen=True)
class AnsweringMap:
    """A map by one recipe, and all that its answers take.

    Parameters
    ----------
    recipe : MapRecipe
    index : SearchableIndex
        Of the map's views by that recipe.
    fetcher : Fetcher
    levels : MapLevels
        What wrong answers get by that recipe.
    calibration : Calibration
    impostors : Impostors or None
    product : Product
        Multiplies dense cells.
    """

    recipe: MapRecipe
    index: SearchableIndex
    fetcher: Fetcher
    levels: MapLevels
    calibration: Calibration
    impostors: Impostors | None
    product: Product

    def answer(self, description: Description, selection: Selection) -> tuple[Ranking, Decision]:
        """Rank the views of a selection for a description by the recipe, and decide.

        Raises
        ------
        ViewGone
            Views that were found, or the index itself, were gone before they could be ranked.
        """
        config = self.recipe.ranking
        found = self.index.search(description.vectors, max(cascade.LISTED, config.searched), selection)
        ranking = cascade.rank(
            self.fetcher.without_fixed(description),
            found,
            self.recipe.description,
            config,
            self.fetcher,
            top=GROUPED,
            product=self.product,
            impostors=self.impostors,
        )
        return ranking, decide(ranking, self.levels, self.calibration, config.precision, searched=found.searched)
