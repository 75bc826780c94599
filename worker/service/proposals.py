"""Proposals: queries that matched a place although they look unlike its views, to be taken as further views of it.

In another light or season a place is matched by little; a view in that light finds the next query by much. What one
query matched is no proof, so that it is confirmed only once another image matched the same place, and nothing is taken
without somebody saying so.
"""

import logging
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from schemas.errors import Conflict, ImageEnrolled, NotFound
from schemas.inbox import KeptQuery, Proposal, Proposals
from schemas.records import Filters, ViewAttributes, ViewRecord
from worker.service.enroll import Enrolled, EnrollService
from worker.service.inbox import EXAMINED, KeptQueries, spread
from worker.service.ports import Maps, Views

log = logging.getLogger("revisit")

ADDED_FROM = "proposed_by"
"""Key in the metadata of a view that was a proposal: the id of its query."""

STILL = 0.3
"""Histogram distance up to which two images may be of a camera that stands still: noise and compression alone gave up
to .29, frames of a walk .64 and more (encoder `compact`)."""

MOST_ADDED = 10
"""Views of a place that may come from proposals: a place in every light and season needs no more."""

LOOKED_THROUGH = 500
"""Views of a place that are looked through at most for those that were proposals."""


class ProposalService:
    """The use-cases around proposed views.

    Parameters
    ----------
    maps, views, kept
        Parts of the store.
    enroll : EnrollService
    """

    def __init__(self, *, maps: Maps, views: Views, kept: KeptQueries, enroll: EnrollService) -> None:
        self._maps, self._views, self._kept, self._enroll = maps, views, kept, enroll

    def of(self, name: str) -> Proposals:
        """The proposals of a map; raises NotFound."""
        record = self._maps.get(name)
        queries, count = self._kept.newest(name, EXAMINED, matched=True)
        known = self._views.at([query.seq for query in queries if query.seq is not None])
        by_place: dict[tuple[str, str], list[tuple[KeptQuery, ViewRecord]]] = {}
        for query in queries:
            view = None if query.seq is None else known.get(query.seq)
            if view is not None:
                place = view.attributes.place
                by_place.setdefault(("view", view.id) if place is None else ("place", place), []).append((query, view))
        proposals = [_proposal(matches) for matches in by_place.values()]
        proposals.sort(key=lambda one: (-len(one.confirmed), -len(one.queries), one.queries))
        return Proposals(tuple(proposals), count, len(queries), record.keep_matches)

    def accept(self, name: str, proposal_id: str, most: int, *, unconfirmed: bool) -> tuple[list[Enrolled], int]:
        """Enrol images of a proposal as views of its place, and remove its queries.

        Returns the views, which are described in the background, and the number of queries removed. Each has the place
        and the position of the view that it matched, and its query under `ADDED_FROM` in its metadata. Queries are
        removed once all images are durable as views: repeated after a refusal half way, or a crash, the call goes on.

        Parameters
        ----------
        name : str
            Of the map.
        proposal_id : str
        most : int
            Images that become views at most, spread evenly over time.
        unconfirmed : bool
            Whether queries that no other one agrees with may be taken.

        Raises
        ------
        NotFound, Busy, DiskFull, StorageFailed
        Conflict
            No two images agree, or the place has `MOST_ADDED` views from proposals.
        """
        proposal = self._find(name, proposal_id)
        choice = proposal.queries if unconfirmed else proposal.confirmed
        if not choice:
            raise Conflict(
                f"no two images of the proposal {proposal_id} agree on their place, so that it may be wrong; wait for "
                "another query, or look at it and accept it with `unconfirmed`"
            )
        room = MOST_ADDED - self._added(name, proposal)
        if room <= 0:
            raise Conflict(f"the place has {MOST_ADDED} views from proposals, as many as are taken; delete some")
        enrolled = []
        for query_id in spread(choice, min(most, room)):
            attributes = self._views.get(proposal.matched[query_id]).attributes
            given = ViewAttributes(attributes.place, attributes.position, metadata={ADDED_FROM: query_id})
            try:
                enrolled.append(self._enroll.take(self._kept.image(name, query_id), name, given))
            except ImageEnrolled:  # one photo that was queried twice: the map has it since the first
                log.info("the image of query %s is a view of the map %s already", query_id, name)
        return enrolled, self._kept.delete(name, proposal.queries)

    def dismiss(self, name: str, proposal_id: str) -> int:
        """Remove the queries of a proposal; returns how many; raises NotFound."""
        return self._kept.delete(name, self._find(name, proposal_id).queries)

    def _find(self, name: str, proposal_id: str) -> Proposal:
        for proposal in self.of(name).proposals:
            if proposal.queries[0] == proposal_id:
                return proposal
        raise NotFound("proposal", proposal_id, f"GET /maps/{name}/proposals lists them")

    def _added(self, name: str, proposal: Proposal) -> int:
        """How many views of a place came from proposals."""
        if proposal.place is None:
            return 0  # each view without a place stands for itself, and a view from a proposal for another one
        filters = Filters(place=proposal.place)
        views, _ = self._views.list(name, filters, newest_first=True, limit=LOOKED_THROUGH)
        return sum(ADDED_FROM in view.attributes.metadata for view in views)


def _proposal(matches: Sequence[tuple[KeptQuery, ViewRecord]]) -> Proposal:
    """The proposal of queries, oldest first, and the views of one place that they matched."""
    queries = [query for query, _ in matches]
    newest = matches[-1][1]
    scores = [query.score for query in queries if query.score is not None]
    return Proposal(
        queries=tuple(query.id for query in queries),
        confirmed=tuple(query.id for query, agrees in zip(queries, _agree(queries), strict=True) if agrees),
        matched={query.id: view.id for query, view in matches},
        place=newest.attributes.place,
        lowest_score=min(scores),
        highest_score=max(scores),
        first_at=queries[0].queried_at,
        last_at=queries[-1].queried_at,
    )


def _agree(queries: Sequence[KeptQuery]) -> npt.NDArray[np.bool_]:
    """Which queries of one place have one of another image among them: a robot that stands still confirms nothing."""
    if len({query.recipe for query in queries}) > 1:
        return np.ones(len(queries), np.bool_)
    vectors = np.stack([query.vectors for query in queries]).astype(np.float64)
    squares = np.einsum("ij,ij->i", vectors, vectors)
    farthest = (squares[:, None] + squares - 2 * vectors @ vectors.T).max(axis=1)
    return np.asarray(farthest > STILL**2)
