"""Inbox: queries that matched nothing, by spot, to be named once or dismissed."""

import threading
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from schemas.errors import NotFound
from schemas.inbox import Inbox, KeptQuery, UnknownPlace
from schemas.latest import Latest
from schemas.records import ViewAttributes
from worker.method.near_duplicates import alike
from worker.method.places import SAME_SPOT_INLIERS
from worker.method.verification import verify
from worker.service.enroll import Enrolled, EnrollService
from worker.service.ports import Maps

T = TypeVar("T")

EXAMINED = 1000
"""Kept queries that are grouped at most, the newest."""

NEAREST = 20
"""Later queries that a query is compared with at a time, by the distance of their histograms: it goes on to the next
ones while some of these show its spot."""

NEAR = 0.45
"""Histogram distance up to which queries show one spot where their recipe has no local features."""

ENROLLED = 10
"""Images of an unknown place that become views when it is named, spread evenly: more add little."""


MOST_KNOWN = 50_000
"""Pairs of queries of which it is remembered whether both show one spot, some 15 MB."""


class KeptQueries(Protocol):
    """Queries that matched nothing, and those that matched a view that they look unlike."""

    def newest(self, name: str, most: int, *, matched: bool = False) -> tuple[list[KeptQuery], int]:
        """The newest `most` queries of a map, oldest first, and how many are kept; raises NotFound."""
        ...

    def image(self, name: str, query_id: str) -> bytes:
        """The small image of a kept query, a JPEG; raises NotFound."""
        ...

    def delete(self, name: str, query_ids: Sequence[str]) -> int:
        """Delete kept queries; returns how many there were."""
        ...


class InboxService:
    """The use-cases around queries that matched nothing.

    Parameters
    ----------
    maps, kept
        Parts of the store.
    enroll : EnrollService
    """

    def __init__(self, *, maps: Maps, kept: KeptQueries, enroll: EnrollService) -> None:
        self._maps, self._kept, self._enroll = maps, kept, enroll
        self._pairs = _Pairs()

    def of(self, name: str) -> Inbox:
        """The unknown places of a map; raises NotFound."""
        record = self._maps.get(name)
        queries, count = self._kept.newest(name, EXAMINED)
        places = sorted(grouped(queries, self._pairs.same), key=lambda place: (-len(place.queries), place.queries))
        return Inbox(tuple(places), count, len(queries), record.keep_queries)

    def image(self, name: str, query_id: str) -> bytes:
        """The small image of a kept query, a JPEG; raises NotFound."""
        return self._kept.image(name, query_id)

    def name(self, name: str, place_id: str, attributes: ViewAttributes) -> tuple[list[Enrolled], int]:
        """Enrol images of an unknown place as views with these attributes, and remove its queries.

        Returns the views, which are described in the background, and the number of queries removed. These are removed
        once all images are durable as views: repeated after a refusal half way, or a crash, the call goes on.

        Raises
        ------
        NotFound, Busy, Conflict, DiskFull, StorageFailed
        """
        place = self._find(name, place_id)
        chosen = spread(place.queries, ENROLLED)
        enrolled = [self._enroll.take(self._kept.image(name, query_id), name, attributes) for query_id in chosen]
        return enrolled, self._kept.delete(name, place.queries)

    def dismiss(self, name: str, place_id: str) -> int:
        """Remove the queries of an unknown place; returns how many; raises NotFound."""
        return self._kept.delete(name, self._find(name, place_id).queries)

    def _find(self, name: str, place_id: str) -> UnknownPlace:
        for place in self.of(name).places:
            if place.queries[0] == place_id:
                return place
        raise NotFound("unknown place", place_id, f"GET /maps/{name}/unknown lists them")


def spread(ids: Sequence[T], most: int) -> list[T]:
    """At most `most` of some ids, evenly over them, in their order."""
    return [ids[i] for i in sorted(set(np.linspace(0, len(ids) - 1, min(len(ids), most)).round().astype(int).tolist()))]


Same = Callable[[KeptQuery, Sequence[KeptQuery]], list[bool]]
"""Which of some queries show the spot of the first one."""


def grouped(queries: Sequence[KeptQuery], same_spot: Same) -> list[UnknownPlace]:
    """Queries by spot: each that shows none of the spots before founds one, and takes all later ones that show it."""
    by_recipe: dict[str, list[KeptQuery]] = {}
    for query in queries:
        by_recipe.setdefault(query.recipe, []).append(query)
    places = []
    for alike_described in by_recipe.values():
        near = alike(np.stack([query.vectors for query in alike_described]), np.inf, len(alike_described))
        taken: set[int] = set()
        for i, query in enumerate(alike_described):
            if i not in taken:
                same = _showing_spot(query, alike_described, [j for j in near[i] if j not in taken], same_spot)
                taken.update(same)
                members = [query, *(alike_described[j] for j in same)]
                ids = tuple(member.id for member in members)
                places.append(UnknownPlace(ids, members[0].queried_at, members[-1].queried_at))
    return places


def _showing_spot(query: KeptQuery, among: Sequence[KeptQuery], near: Sequence[int], same_spot: Same) -> list[int]:
    """Numbers of those that show the spot of a query, ascending; `near`: those that are looked at, nearest first."""
    same: list[int] = []
    for start in range(0, len(near), NEAREST):
        next_ones = near[start : start + NEAREST]
        shown = same_spot(query, [among[j] for j in next_ones])
        found = [j for j, shows in zip(next_ones, shown, strict=True) if shows]
        if not found:
            break
        same += found
    return sorted(same)


class _Pairs:
    """Remembers of pairs of queries whether both show one spot: the next list has nearly the same ones."""

    def __init__(self) -> None:
        self._known: Latest[tuple[str, str], bool] = Latest(MOST_KNOWN)
        self._lock = threading.Lock()

    def same(self, query: KeptQuery, others: Sequence[KeptQuery]) -> list[bool]:
        """Which of the others show the spot of a query."""
        with self._lock:
            known = {other.id: self._known.get((query.id, other.id)) for other in others}
        unknown = [other for other in others if known[other.id] is None]
        found = {other.id: shows for other, shows in zip(unknown, _same(query, unknown), strict=True)}
        with self._lock:
            self._known.update({(query.id, other): shows for other, shows in found.items()})
        return [bool(found.get(other.id, known[other.id])) for other in others]


def _same(query: KeptQuery, others: Sequence[KeptQuery]) -> list[bool]:
    """Which of the others show the spot of a query."""
    features = [other.keypoints for other in others if other.keypoints is not None]
    if query.keypoints is None or len(features) < len(others):
        return [float(np.linalg.norm(query.vectors - other.vectors)) <= NEAR for other in others]
    return [found.inliers >= SAME_SPOT_INLIERS for found in verify(query.keypoints, features)]
