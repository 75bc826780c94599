"""What changed at a place: between two views of it, or between a view and a query that matched it."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from schemas.description import Doubles
from schemas.errors import ImageNotKept, InvalidParameters
from schemas.image import Image
from schemas.latest import Latest
from schemas.recipe import DescriptionRecipe
from schemas.records import MapRecord, ViewRecord
from worker.description.describer import components
from worker.description.describers import Describers
from worker.description.local_features import local_features
from worker.description.scheduler import Scheduler, field_alone
from worker.images.changes import Mark, Side, changes_png
from worker.method import changes, verification
from worker.method.changes import Change, Changes
from worker.method.lost_cells import PhotoCells
from worker.service.explanations import Explanations
from worker.service.ports import Maps, Views
from worker.service.renderings import refuse_forgotten
from worker.service.sheets import name_of

KEYPOINTS = 300
"""Local features of each photo, which align the two."""

LEAST_INLIERS = 12
"""Fewer keypoints than this align no two photos well enough to say what changed."""

RECENT = 16
"""Comparisons kept, since a drawing is asked for just after its words."""

Status = Literal["compared", "not-aligned", "image-not-kept", "no-match"]

NOT_KEPT = "the map keeps no images, so there is no photo of the place as it was"
NOT_ALIGNED = (
    "{} keypoints fit one geometry, and {} are needed to say where a thing should be: take the photo from nearer "
    "to where the view was taken, by better light"
)
NO_MATCH = "the photo matched no view, so there is nothing to compare it with"


@dataclass(frozen=True, eq=False)
class Comparison:
    """What changed since a view was taken, or why that cannot be said.

    Parameters
    ----------
    status : {"compared", "not-aligned", "image-not-kept", "no-match"}
    detail : str
        Why nothing was compared; empty where it was.
    since : str or None
        Id of the earlier view.
    recipe : DescriptionRecipe or None
        Whose labels these are.
    found : Changes or None
        None unless compared.
    """

    status: Status
    detail: str = ""
    since: str | None = None
    recipe: DescriptionRecipe | None = None
    found: Changes | None = None


@dataclass(frozen=True, eq=False)
class Aligned:
    """Two photos as cells, and where those of the earlier one lie in the later one.

    Parameters
    ----------
    then, now : PhotoCells
    transform : float64 of shape (2, 3)
        Affine, as `worker.method.changes.find` takes it.
    """

    then: PhotoCells
    now: PhotoCells
    transform: Doubles


@dataclass(frozen=True, eq=False)
class _Photo:
    id: str
    image: Image
    title: str


class ChangeService:
    """The use-case `what changed here`.

    Parameters
    ----------
    maps, views
        Parts of the store.
    describers : Describers
    scheduler, segmenting
        See `worker.runtime.parts.Parts`.
    decode : function
        Bytes to Image; raises BadImage.
    explanations : Explanations
        The latest explained queries.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        views: Views,
        describers: Describers,
        scheduler: Scheduler,
        segmenting: Scheduler | None,
        decode: Callable[[bytes], Image],
        explanations: Explanations,
    ) -> None:
        self._maps, self._views, self._describers = maps, views, describers
        self._scheduler, self._segmenting = scheduler, segmenting
        self._decode, self._explanations = decode, explanations
        self._recent: Latest[tuple[str, str, str], Comparison] = Latest(RECENT)

    def between(self, view_id: str, since: str) -> Comparison:
        """What changed from the view `since` to another one of its map.

        Raises
        ------
        NotFound, InvalidParameters, ImageNotKept, Busy
        """
        return self._compare(*self._two(view_id, since))

    def draw_between(self, view_id: str, since: str) -> bytes:
        """Both views with what changed outlined, as PNG; raises as `between`."""
        return self._drawn(*self._two(view_id, since))

    def of_query(self, query_id: str) -> Comparison:
        """What changed from the first match of an explained query to its image; raises NotFound, Busy."""
        explained = self._explanations.get(query_id)
        if explained.headline.status == "no_match" or not explained.views:
            return Comparison("no-match", NO_MATCH)
        first = explained.views[0].view
        with suppress(ImageNotKept):
            return self._compare(self._maps.get(first.map), first, self._photo(first), self._query_photo(query_id))
        return Comparison("image-not-kept", NOT_KEPT, first.id)

    def draw_query(self, query_id: str) -> bytes:
        """The first match of an explained query and its image with what changed outlined, as PNG.

        Raises
        ------
        NotFound, ImageNotKept, Busy
        """
        first = self._views.get(self._explanations.get(query_id).view(None).view.id)  # by the name that it has now
        return self._drawn(self._maps.get(first.map), first, self._photo(first), self._query_photo(query_id))

    def version(self, view_id: str, since: str) -> str:
        """A version of the drawing of two views, for an ETag; raises NotFound, ImageNotKept."""
        one, other = self._views.get(view_id), self._views.get(since)
        owner = self._maps.get(one.map)
        refuse_forgotten(one, owner)
        named = hashlib.sha256(f"{name_of(one)}\n{name_of(other)}".encode()).hexdigest()[:12]  # it is drawn with them
        return f"{one.id}-{other.id}-{owner.description.id}-{named}-changes"

    def _query_photo(self, query_id: str) -> _Photo:
        explained = self._explanations.get(query_id)
        return _Photo(query_id, explained.photo or explained.image, "now: query")

    def _photo(self, view: ViewRecord, when: str = "then") -> _Photo:
        return _Photo(view.id, self._decode(self._views.image(view.id)), f"{when}: {name_of(view)}")

    def _two(self, view_id: str, since: str) -> tuple[MapRecord, ViewRecord, _Photo, _Photo]:
        now, then = self._views.get(view_id), self._views.get(since)
        if now.id == then.id:
            raise InvalidParameters.of("since", "is the view itself; name another view of the place")
        if now.map != then.map:
            raise InvalidParameters.of("since", f"is a view of the map {then.map!r}; name another one of {now.map!r}")
        return self._maps.get(now.map), then, self._photo(then), self._photo(now, "now")

    def aligned(self, then: Image, now: Image, recipe: DescriptionRecipe) -> tuple[int, Aligned | None]:
        """Two photos as cells, laid over one another.

        Returns
        -------
        inliers : int
            Keypoints that fit one geometry.
        aligned : Aligned or None
            None when there are fewer than `LEAST_INLIERS`.

        Raises
        ------
        Busy
        """
        features = [local_features(image.pixels, KEYPOINTS) for image in (then, now)]
        [fits] = verification.verify(features[0], features[1:])
        if fits.transform is None or fits.inliers < LEAST_INLIERS:
            return fits.inliers, None
        looks = [self._look(image, recipe) for image in (then, now)]
        return fits.inliers, Aligned(looks[0], looks[1], fits.transform.astype(np.float64))

    def compare(self, then: Image, now: Image, recipe: DescriptionRecipe) -> tuple[int, Changes | None]:
        """What changed from one photo to another, by the labels of a recipe.

        Returns
        -------
        inliers : int
            Keypoints that fit one geometry.
        found : Changes or None
            None when there are fewer than `LEAST_INLIERS`.

        Raises
        ------
        Busy
        """
        inliers, both = self.aligned(then, now, recipe)
        return inliers, None if both is None else changes.find(both.then, both.now, both.transform, components)

    def _compare(self, owner: MapRecord, view: ViewRecord, then: _Photo, now: _Photo) -> Comparison:
        """The comparison of two photos; a recent one is used again, since the photo of an id never changes."""
        key = then.id, now.id, owner.description.id
        known = self._recent.get(key)
        if known is None:
            known = self._recent[key] = self._compared(owner.description, view, then, now)
        return known

    def _compared(self, recipe: DescriptionRecipe, view: ViewRecord, then: _Photo, now: _Photo) -> Comparison:
        inliers, found = self.compare(then.image, now.image, recipe)
        if found is None:
            return Comparison("not-aligned", NOT_ALIGNED.format(inliers, LEAST_INLIERS), view.id, recipe)
        return Comparison("compared", "", view.id, recipe, found)

    def _drawn(self, owner: MapRecord, view: ViewRecord, then: _Photo, now: _Photo) -> bytes:
        comparison = self._compare(owner, view, then, now)
        sides = [Side(photo.image.pixels, photo.title) for photo in (then, now)]
        if comparison.found is None:
            return changes_png(sides[0], sides[1], f"not compared: {comparison.detail}")
        names = owner.description.labels
        sides = [
            replace(side, marks=[mark for one in comparison.found.changes if (mark := _mark(one, when, names))])
            for side, when in zip(sides, ("then", "now"), strict=True)
        ]
        return changes_png(sides[0], sides[1], summary(comparison.found, names))

    def _look(self, image: Image, recipe: DescriptionRecipe) -> PhotoCells:
        """An image as cells: embeddings of the encoder, labels of the segmenter where there is one."""
        field = self._scheduler.submit(image, field_alone, urgent=True).result().value
        segmented = field
        if self._segmenting is not None:
            segmented = self._segmenting.submit(image, field_alone, urgent=True).result().value
        return self._describers.of(recipe).photo_cells(field, segmented)


def summary(found: Changes, names: Sequence[str]) -> str:
    """What changed, in a sentence."""
    words = [
        f"{names[one.label]} {one.kind}"
        + ("" if one.instead is None else f" ({names[one.instead]} in the other photo)")
        for one in found.changes
    ]
    share = f"{100 * found.compared:.0f} % of the later photo could be compared"
    return f"{', '.join(words) or 'nothing changed that could be told'}; {share}"


def _mark(change: Change, when: str, names: Sequence[str]) -> Mark | None:
    """A change as it is outlined in the photo of then, or of now; None where it is not seen there."""
    spot = change.then if when == "then" else change.now
    if spot is None:
        return None
    return Mark(change.kind, f"{names[change.label]} {change.kind} {change.confidence:.2f}", spot.cells)
