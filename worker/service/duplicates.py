"""Whether a map has nearly the same image already."""

import numpy as np

from schemas.description import Description
from schemas.errors import NotFound
from schemas.records import Selection, Sequence64, ViewRecord
from worker.method import near_duplicates
from worker.method.camera_fixed import CameraFixed
from worker.method.cascade import ViewGone
from worker.search.ports import Catalogue, DescriptionReader
from worker.service.ports import Views
from worker.service.sheets import name_of

NEAREST = 5
"""Views that are looked at by each channel: one that shows the same image is among the very nearest."""

ROUNDS = 5
"""Attempts while the map changes."""


class NearDuplicates:
    """Finds near-duplicates by the index of a map. Nothing is encoded, and nothing is ranked.

    Parameters
    ----------
    views, descriptions
        Parts of the store.
    catalogue : Catalogue
    """

    def __init__(self, views: Views, descriptions: DescriptionReader, catalogue: Catalogue) -> None:
        self._views, self._descriptions, self._catalogue = views, descriptions, catalogue

    def of(self, name: str, recipe: str, description: Description, but: int | None = None) -> ViewRecord | None:
        """The nearest view of a map that shows nearly the same image as a description.

        Parameters
        ----------
        name : str
            Of the map.
        recipe : str
            Id of the recipe of the description.
        description : Description
        but : int, optional
            Sequence number of a view that is not looked at: the one that is described.

        Returns
        -------
        ViewRecord or None
            None also where that cannot be told: the map is gone, changes too fast, or has another recipe by now.
        """
        never = np.array([] if but is None else [but], np.int64)
        for _ in range(ROUNDS):
            try:
                index, record = self._catalogue.index(name)
                if record.description.id != recipe:
                    return None
                found = index.search(description.vectors, NEAREST, Selection(None, never))
            except ViewGone:
                continue
            except NotFound:
                return None
            squares = np.sum([found.distances[channel].astype(np.float64) ** 2 for channel in found.distances], axis=0)
            near = np.flatnonzero(squares <= near_duplicates.NEAR**2)
            fixed = self._catalogue.camera_fixed(index, record.description)
            return self._same(found.seqs[near[np.argsort(squares[near], kind="stable")]], recipe, description, fixed)
        return None

    def _same(
        self, seqs: Sequence64, recipe: str, description: Description, fixed: CameraFixed | None
    ) -> ViewRecord | None:
        """The first of some views whose cells are nearly those of a description."""
        cells = self._descriptions.appearances(seqs.tolist(), recipe)
        for seq in seqs.tolist():
            mine = description.appearance.coarse
            if seq in cells and near_duplicates.similarity(mine, cells[seq].coarse, fixed) >= near_duplicates.SAME:
                view = self._views.at([seq]).get(seq)
                if view is not None:
                    return view
        return None


def detail_of(view: ViewRecord) -> str:
    """That an image adds nothing beside a view, in words."""
    return f"nearly the same image is enrolled already, as {named(view)}; it adds nothing"


def named(view: ViewRecord) -> str:
    """A view by its name and id, in words."""
    name = name_of(view)
    return f"the view {view.id}" if name == view.id else f"{name!r} (view {view.id})"
