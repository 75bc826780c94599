"""Drives under way: what their images say together, and the decision that follows from it."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.latest import Latest
from worker.method.decision import GROUPED, Decision, PlaceProbability, confidences
from worker.method.drive import Drive, Single, follow, spread
from worker.method.evidence import Ranking
from worker.method.features import SOFTENING
from worker.method.reasons import Reason
from worker.service.agreement import Row
from worker.service.results import RankedResults

DRIVEN = 20
"""Views that an image of a drive may be decided for, however many are wanted; a single image decides for fewer."""

LISTED = 1e-3
"""Least probability of a view whose place is told of, the likeliest apart."""

MOST = 1000
"""Drives that are followed at once; the one that was silent longest is forgotten first."""

LIKELIER = 0.5
"""Probability from which a place is likelier than everything else together."""

LEADS = 0.2
"""Probability from which the place that a drive finds likeliest comes before those of an image that is not `matched`:
by itself such an image hardly tells one place from another."""

TOGETHER = Reason("sure", "the images of this drive together single out one place", "nothing")
LEANING = Reason(
    "weak",
    "the images of this drive together make this place the likeliest, and are not sure of it yet",
    "send the next images of the drive",
)


@dataclass(frozen=True)
class Driven:
    """What the images of a drive say together.

    Parameters
    ----------
    images : int
        That were followed, this one included; 1 when the drive is new, or was forgotten.
    posterior : tuple of PlaceProbability
        Most probable first; indices into the views of the results. Places whose views hardly count are left out.
    single_status : str
        The verdict on this image alone.
    agreeing : int
        Images in a row, up to this one, that are matched one by one and come back to one stretch of the map.
    """

    images: int
    posterior: tuple[PlaceProbability, ...]
    single_status: str
    agreeing: int

    @property
    def nowhere(self) -> float:
        """Probability that the image shows none of these places."""
        return max(0.0, 1.0 - sum(place.probability for place in self.posterior))


@dataclass(frozen=True)
class _Path:
    """A drive up to one of its images."""

    drive: Drive
    row: Row


@dataclass(frozen=True)
class _Kept:
    """A drive's last image: what was known before and after it; `of` is the number of its map, and the recipe."""

    call: str | None
    before: _Path
    after: _Path
    of: tuple[int, str]
    at: float

    def goes_on(self, of: tuple[int, str], now: float, timeout_s: float) -> bool:
        """Whether an image that is taken now is the next one: not in another map of the name, or by another recipe."""
        return self.of == of and now - self.at <= timeout_s


class Drives:
    """Follows drives. They are kept in memory: a restart begins them anew, which `Driven.images` shows.

    Parameters
    ----------
    further : function
        Results with so many of their candidates as views, or fewer where some are gone.
    now : function
        Seconds of a clock that never goes back.
    """

    def __init__(
        self, further: Callable[[RankedResults, int], RankedResults], now: Callable[[], float] = time.monotonic
    ) -> None:
        self._further, self._now = further, now
        self._kept: Latest[tuple[str, str], _Kept] = Latest(MOST)
        self._lock = threading.Lock()

    def follow(
        self,
        key: tuple[str, str],
        timeout_s: float,
        results: RankedResults,
        decision: Decision,
        consistent: int | None = None,
        call: str | None = None,
        blank: bool = False,
    ) -> tuple[RankedResults, Decision, Driven]:
        """Take one more image of a drive into account.

        Where the images together are as sure as the precision asks for, the decision is theirs and the views of their
        place come first. They come first too where the image by itself is not `matched` and that place has a
        probability of at least `LEADS`: as `ambiguous` where it is likelier than everything else, else with the image's
        own verdict, and with its own reason where its own first place is that one. Otherwise the image's own decision
        stands. With `consistent` the decision is always the image's own, and `matched` only where enough images in a
        row agree.

        Parameters
        ----------
        key : (str, str)
            Map and name of the drive.
        timeout_s : float
            The drive is forgotten when its last image is older.
        results : RankedResults
            Its views are those of a single image; where the drive is for others, these are looked up.
        decision : Decision
            On the image alone.
        consistent : int, optional
            Images in a row that must be matched one by one and come back to one stretch of the map.
        call : str, optional
            Names the call. That of the drive's last image, repeated since its answer was lost, counts once; without a
            name every call is another image.
        blank : bool
            The image shows nothing, so it says nothing of where it was taken: the drive is left as it is.
        """
        of, now = (results.maps[0].number, results.recipe.description.id), self._now()
        if blank or not results.views:
            path = self._path(key, timeout_s, of, ends_row=not blank)
            return results, decision, Driven(path.drive.images, (), decision.status, path.row.images)
        single = _single(results, decision)
        with self._lock:
            kept = self._kept.get(key)
            before = _Path(Drive(), Row())
            if kept is not None and kept.goes_on(of, now, timeout_s):
                before = kept.before if call is not None and call == kept.call else kept.after
            drive, together = follow(before.drive, single)
            row = before.row.followed_by(int(results.ranking.order[0]) if decision.status == "matched" else None)
            self._kept[key] = _Kept(call, before, _Path(drive, row), of, now)
        probability = dict(zip(single.seqs.tolist(), together.tolist(), strict=True))
        results, posterior, count = self._together(results, probability)
        driven = Driven(drive.images, posterior, decision.status, row.images)
        if consistent is not None:
            return results, _consistent(decision, row.images, consistent), driven
        likeliest = posterior[0].probability
        if drive.images == 1:
            return results, decision, driven
        if likeliest >= decision.threshold:
            decision = replace(decision, status="matched", reason=TOGETHER)
        elif decision.status == "matched" or likeliest < LEADS:
            return results, decision, driven
        elif likeliest >= LIKELIER:
            decision = replace(decision, status="ambiguous", reason=LEANING)
        elif decision.places[0].views[0] not in posterior[0].views:
            decision = replace(decision, reason=LEANING)  # the image's own is of the place that comes first by itself
        places = _by_place(results.ranking, count, len(results.views), probability, 0.0)
        return _led(results, decision, driven, _shown(places, len(results.views)), probability)

    def _together(
        self, results: RankedResults, probability: Mapping[int, float]
    ) -> tuple[RankedResults, tuple[PlaceProbability, ...], int]:
        """Results with the views that count, their places, and of how many candidates these are.

        Most images are for views that they have already: looking up more takes longer than all the rest.
        """
        ranking = results.ranking
        # Of further ones the places are not known: see `Ranking.places`.
        known = len(ranking.seqs) if not ranking.reranked else max(ranking.reranked, len(results.views))
        count = min(known, max(DRIVEN, len(results.views)))
        posterior = _by_place(ranking, count, len(results.views), probability)
        needed = 1 + max(view for place in posterior for view in place.views)
        if needed > len(results.views):
            results = self._further(results, needed)
            if needed > len(results.views):
                count = len(results.views)
                posterior = _by_place(ranking, count, count, probability)
        return results, posterior, count

    def _path(self, key: tuple[str, str], timeout_s: float, of: tuple[int, str], ends_row: bool) -> _Path:
        """The drive up to its last image; a new one where there is none, or its last image is too old.

        `ends_row`: after an image that is matched to nothing, since no view was searched.
        """
        with self._lock:
            kept = self._kept.get(key)
            if kept is None or not kept.goes_on(of, self._now(), timeout_s):
                return _Path(Drive(), Row())
            if ends_row:
                kept = self._kept[key] = replace(kept, after=replace(kept.after, row=Row()))
            return kept.after


def _consistent(decision: Decision, agreeing: int, wanted: int) -> Decision:
    """The decision on an image alone, `ambiguous` where it is `matched` and too few images in a row agree."""
    if decision.status != "matched" or agreeing >= wanted:
        return decision
    detail = f"this image alone is sure, but only {agreeing} of {wanted} images in a row of this drive agree on where"
    return replace(decision, status="ambiguous", reason=Reason("sure", detail, "send the next images of the drive"))


def _led(
    results: RankedResults,
    decision: Decision,
    driven: Driven,
    places: tuple[PlaceProbability, ...],
    probability: Mapping[int, float],
) -> tuple[RankedResults, Decision, Driven]:
    """The answer with its places in the order of their probability by the drive.

    A place has its neighbours here, so that each view's position counts by the probability of the view itself.
    """
    order = [view for place in places for view in place.views]
    rank = {view: i for i, view in enumerate(order)}
    places = tuple(PlaceProbability(p.probability, tuple(rank[view] for view in p.views)) for p in places)
    views = tuple(results.views[i] for i in order)
    decided = replace(
        decision,
        confidence=places[0].probability,
        places=places,
        confidences=confidences(places),
        weights=tuple(probability.get(int(results.ranking.seqs[i]), 0.0) for i in order),
    )
    rival = results.rival
    if decision.reason.code != "look-alike":  # that of the image itself has a rival of its own
        rival = views[places[1].views[0]] if len(places) > 1 else None
    driven = replace(driven, posterior=places[: len(driven.posterior)])
    return replace(results, views=views, rival=rival), decided, driven


def _single(results: RankedResults, decision: Decision) -> Single:
    """What the image says on its own of each re-ranked candidate."""
    ranking = results.ranking
    count = ranking.reranked or len(ranking.seqs)
    seqs, order, scores = ranking.seqs[:count], ranking.order[:count], ranking.scores[:count].astype(np.float64)
    best = decision.places[0]
    first = np.zeros(count, np.bool_)
    first[[view for view in best.views if view < min(count, GROUPED)]] = True
    shared = spread(scores, first, best.probability, decision.levels.gap + SOFTENING)
    ascending = np.argsort(seqs)
    return Single(seqs[ascending], order[ascending], shared[ascending], results.searched)


def _by_place(
    ranking: Ranking, count: int, shown: int, probability: Mapping[int, float], least: float = LISTED
) -> tuple[PlaceProbability, ...]:
    """Probabilities of the first `count` views, added up by place, most probable first; views behind `DRIVEN` have 0.

    A place is that of its likeliest view. Probabilities of its neighbours count for it too, since they are no rivals of
    it. Places whose views are all below `least` are left out, unless there is no other. Of the other places, views
    below `least` are left out if they come behind the first `shown`.
    """
    seqs = [int(seq) for seq in ranking.seqs[:count]]
    each = [float(probability.get(seq, 0.0)) if view < DRIVEN else 0.0 for view, seq in enumerate(seqs)]
    left = sorted(range(count), key=lambda view: (-each[view], view))
    places: list[PlaceProbability] = []
    while left and (not places or each[left[0]] >= least):
        best = left[0]
        near = [view for view in left if not ranking.places.apart(seqs[best], seqs[view])]
        told = tuple(view for view in near if view == best or view < shown or each[view] >= least)
        places.append(PlaceProbability(sum(each[view] for view in near), told))
        left = [view for view in left if view not in near]
    return tuple(sorted(places, key=lambda place: -place.probability))


def _shown(places: Sequence[PlaceProbability], count: int) -> tuple[PlaceProbability, ...]:
    """Places by those of their views that are among the first `count`, without places that have none there."""
    kept = ((place, tuple(view for view in place.views if view < count)) for place in places)
    return tuple(replace(place, views=views) for place, views in kept if views)
