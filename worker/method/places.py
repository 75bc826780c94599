"""Places: which views show the same spot, by what the user said of them and by the map's own comparison."""

from collections.abc import Mapping, Sequence
from math import inf

from schemas.comparisons import KnownView
from schemas.records import Position
from worker.method.positions import climb, distance

NEIGHBOURHOOD = 4.0
"""Views further apart than a place is wide, but not more than this many times, are neighbours: along a path they show
much of the same things, so they are evidence neither for the place nor against it."""

STOREY_M = 2.0
"""Views of two names are on two storeys when one lies this much higher than the other in the map's frame, metres: rooms
are no lower. Heights of satellite positions are off by more than that."""

STEEP = 6.0
"""Of views on two storeys one is above the other where the way between them is at most this many times its height: few
paths and streets are as steep."""

ENOUGH_VIEWS, ENOUGH_PLACES = 20, 10
"""Views of other places, and other places. The best of fewer scores less than wrong answers get in a map of usual size:
then neighbours are rivals too."""

SAME_SPOT_INLIERS, SAME_SPOT_SCORE = 40, 0.55
"""Two views show the same spot when this many keypoints agree, of 300, and they score this much. Of pairs of views of
look-alike floors 99 in 100 have at most 31."""


class Places:
    """Which of some views are of one place.

    Parameters
    ----------
    known : mapping of sequence number to KnownView
    same_place_m : float
        Views at most this far apart are of one place, metres.

    Notes
    -----
    Two views are of one place when they have the same name, or lie at most `same_place_m` apart, or the map's own
    comparison says so and the user does not tell them apart: equal doors on two floors look like one spot. Views on
    two storeys are never of one place, even where a storey is lower than a place is wide; where one is above the other
    they are no neighbours either. The same holds for views of different maps that are searched together. Being of one
    place is no equivalence: along a path each view shares a place with the next. A place is therefore always that of
    one view, the best.
    """

    def __init__(self, known: Mapping[int, KnownView], same_place_m: float) -> None:
        self._known, self._within = known, same_place_m

    def joined(self, known: Mapping[int, KnownView]) -> "Places":
        """These views and further ones."""
        return Places({**self._known, **known}, self._within)

    def positions(self, near: int) -> list[Position]:
        """Positions of all views on the storey of this one, by its sequence number."""
        return [view.position for seq, view in self._known.items() if self.on_one_storey(near, seq)]

    def on_one_storey(self, one: int, other: int) -> bool:
        """Whether two views are of one map, and their names and heights do not say that they are on two storeys."""
        a, b = self._known[one], self._known[other]
        named = a.name is not None and b.name is not None and a.name != b.name
        framed = a.position.z is not None
        return a.map == b.map and not (named and framed and climb(a.position, b.position) >= STOREY_M)

    def _is_far(self, one: int, other: int, gap: float) -> bool:
        """Whether two views of one map, `gap` metres apart, are no neighbours by that, or one is above the other."""
        if gap > NEIGHBOURHOOD * self._within:
            return True
        steep = gap <= STEEP * climb(self._known[one].position, self._known[other].position)
        return steep and not self.on_one_storey(one, other)

    def same(self, one: int, other: int) -> bool:
        """Whether two views, by sequence number, are of one place."""
        a, b = self._known[one], self._known[other]
        return a.map == b.map and self._is_same(one, other, distance(a.position, b.position))

    def _is_same(self, one: int, other: int, gap: float) -> bool:
        """`same`, of two views of one map, `gap` metres apart."""
        a, b = self._known[one], self._known[other]
        named = a.name is not None and b.name is not None
        if one == other or (named and a.name == b.name):
            return True
        if gap <= self._within:
            return self.on_one_storey(one, other)
        told_apart = named or NEIGHBOURHOOD * self._within < gap < inf
        return not told_apart and (other in a.same_spot or one in b.same_spot)

    def alike(self, one: int, other: int) -> bool:
        """Whether two views are of one place, or of places that the map's own comparison takes for one, or may take:
        views of different maps have not been compared."""
        a, b = self._known[one], self._known[other]
        return self.same(one, other) or a.map != b.map or other in a.same_spot or one in b.same_spot

    def apart(self, one: int, other: int) -> bool:
        """Whether two views are of different places and not neighbours either."""
        a, b = self._known[one], self._known[other]
        if a.map != b.map:  # positions of two maps lie in frames of their own
            return True
        gap = distance(a.position, b.position)
        return self._is_far(one, other, gap) and not self._is_same(one, other, gap)

    def told_apart(self, one: int, other: int) -> bool:
        """Whether the user says of two views that they are of different places: by their positions, else by names; by
        both where one is above the other."""
        a, b = self._known[one], self._known[other]
        gap = distance(a.position, b.position)
        named = a.name is not None and b.name is not None
        return not self.same(one, other) and (self._is_far(one, other, gap) if gap < inf else named)

    def group(self, ranked: Sequence[int]) -> list[list[int]]:
        """Views by place: each place is that of its best view, and takes all later views that share it.

        Parameters
        ----------
        ranked : sequence of int
            Sequence numbers, best first.

        Returns
        -------
        list of list of int
            Indices into `ranked`, best place first, best view of each first.
        """
        left = list(range(len(ranked)))
        groups = []
        while left:
            best = ranked[left[0]]
            shared = {i for i in left if self.same(best, ranked[i])}
            groups.append([i for i in left if i in shared])
            left = [i for i in left if i not in shared]
        return groups
