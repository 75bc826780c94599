"""Views: shown, listed, changed, deleted; and their places."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.description import Floats
from schemas.errors import Conflict, InvalidParameters
from schemas.records import Filters, PlaceRecord, ViewAttributes, ViewRecord
from schemas.removal import Removal
from worker.method.label_terms import dropped, presence
from worker.service.label_search import terms_of
from worker.service.ports import Listings, Maps, Removals, Views


@dataclass(frozen=True, eq=False)
class LabelledView:
    """A view and the labels to which its label shares refer: those of the recipe that it is described by."""

    record: ViewRecord
    labels: tuple[str, ...]


def labelled(records: Sequence[ViewRecord], maps: Maps) -> list[LabelledView]:
    """Views with their labels, which may not be their map's any more: it may have changed over since they were read."""
    recipes = {record.description.recipe for record in records if record.description is not None}
    labels = {recipe: maps.labels(recipe) for recipe in recipes}
    found = []
    for record in records:
        own = () if record.description is None else labels[record.description.recipe]
        # A recipe that was removed meanwhile leaves nothing to say of the description.
        found.append(LabelledView(record if own else replace(record, description=None), own))
    return found


@dataclass(frozen=True, eq=False)
class DynamicPreview:
    """What a map's descriptions would leave out if other labels were dynamic; shares are upper bounds, 0..1.

    Parameters
    ----------
    views : int
        Described views of the map.
    before, after : float
        Mean share that is left out, by the present and by the other labels.
    nothing_left : int
        Views that would be left without anything static, and could not be described.
    labels : tuple of (label, mean share, number of views that show it)
        The other labels.
    most : tuple of (view, share)
        Those that would lose most.
    """

    views: int
    before: float
    after: float
    nothing_left: int
    labels: tuple[tuple[str, float, int], ...]
    most: tuple[tuple[LabelledView, float], ...]


class ViewService:
    """The use-cases around views.

    Parameters
    ----------
    maps, views, removals, listings
        Parts of the store.
    """

    def __init__(self, *, maps: Maps, views: Views, removals: Removals, listings: Listings) -> None:
        self._maps, self._views, self._removals, self._listings = maps, views, removals, listings

    def get(self, view_id: str) -> LabelledView:
        """One view; raises NotFound."""
        return self._labelled(self._views.get(view_id))

    def page(
        self,
        map_name: str | None,
        filters: Filters,
        *,
        state: str | None,
        newest_first: bool,
        cursor: str | None,
        limit: int,
        among: Collection[str] | None = None,
    ) -> tuple[list[LabelledView], str | None]:
        """A page of views in enrolment order (or reverse), and the cursor of the next; `among`: of these maps alone."""
        records, following = self._views.list(
            map_name, filters, state=state, newest_first=newest_first, cursor=cursor, limit=limit, among=among
        )
        return labelled(records, self._maps), following

    def with_words(
        self, map_name: str, filters: Filters, words: str, *, cursor: str | None, limit: int
    ) -> tuple[list[LabelledView], str | None]:
        """A page of a map's views by how much of them some labels are, most first, and the cursor of the next.

        Raises
        ------
        NotFound, InvalidParameters
        """

        def score(labels: Sequence[str], shares: Floats) -> Floats:
            return presence(shares, terms_of(words, labels, map_name))

        records, following = self._views.ranked(map_name, filters, score, cursor=cursor, limit=limit)
        return labelled(records, self._maps), following

    def preview_dynamic(self, map_name: str, wanted: Sequence[str], limit: int) -> DynamicPreview:
        """What would be left out of the views of a map if these labels were dynamic, without describing anything.

        Raises
        ------
        NotFound
        InvalidParameters
            A label is none of the map's.
        """
        recipe = self._maps.get(map_name).description
        index = {label.casefold(): number for number, label in enumerate(recipe.labels)}
        unknown = [label for label in wanted if label.casefold() not in index]
        if unknown:
            raise InvalidParameters.of(
                "dynamic",
                f"{', '.join(map(repr, unknown))}: no label of the map, whose labels are {', '.join(recipe.labels)}",
            )
        numbers = sorted({index[label.casefold()] for label in wanted})
        present = [index[label.casefold()] for label in recipe.dynamic]
        limit_share = recipe.parameters.dynamic.most
        every = np.zeros((0, len(recipe.labels)), np.float32)

        def score(labels: Sequence[str], shares: Floats) -> Floats:
            nonlocal every
            if tuple(labels) != recipe.labels:
                raise Conflict(f"the labels of the map {map_name!r} were changed meanwhile; try again")
            every = shares
            return dropped(shares, numbers, limit_share)

        records, _ = self._views.ranked(map_name, Filters(), score, limit=limit)
        after = dropped(every, numbers, limit_share)
        count = max(len(every), 1)
        described = [(one, one.description.label_shares) for one in records if one.description is not None]
        return DynamicPreview(
            views=len(every),
            before=float(dropped(every, present, limit_share).sum() / count),
            after=float(after.sum() / count),
            nothing_left=int((after == 1).sum()),
            labels=tuple(
                (recipe.labels[n], float(every[:, n].sum() / count), int((every[:, n] > 0).sum())) for n in numbers
            ),
            most=tuple(
                (LabelledView(one, recipe.labels), float(dropped(shares[None], numbers, limit_share)[0]))
                for one, shares in described
            ),
        )

    def change(self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> LabelledView:
        """Replace a view's attributes in one transaction; raises NotFound, and what `change` raises."""
        return self._labelled(self._views.change(view_id, change))

    def delete(self, view_id: str) -> Removal:
        """Remove a view; raises NotFound."""
        return self._removals.delete_view(view_id)

    def delete_matching(self, map_name: str, filters: Filters) -> Removal:
        """Remove the views of a map that the filters select; raises NotFound."""
        return self._removals.delete_views(map_name, filters)

    def places(
        self, map_name: str | None, cursor: str | None, limit: int, among: Collection[str] | None = None
    ) -> tuple[list[PlaceRecord], str | None]:
        """A page of places by map and name, and the cursor of the next; `among`: of these maps alone."""
        return self._listings.places(map_name, cursor, limit, among)

    def _labelled(self, record: ViewRecord) -> LabelledView:
        [found] = labelled([record], self._maps)
        return found
