"""Drives: evidence of consecutive images adds up, by a Bayes filter over the views of a map and "nowhere".

The discrete filter of Markov localisation (Thrun, Burgard, Fox: Probabilistic Robotics, 2005, section 8.2), with two
models of motion beside each other. By the first, the next image is taken some views further along the order of
enrolment; by the second, anywhere. How well each foretold the images so far decides how much it counts: on a walk the
first soon has nearly all the weight, and with shuffled images the answer is that of the single image.

Two things tell a walk on the map from one beside it. How far a robot moves on between two images is learnt from the
drive itself (expectation maximisation as it goes), so that a path at a steady pace soon counts for more than a jumpy
one. And what is not on the map may look like some view of it, for many images in a row: such a resemblance stays
where it is, while a path moves on.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from schemas.description import Booleans, Doubles
from schemas.records import Sequence64

KNOWN = 0.7
"""Probability that an image shows something of the map, before anything is known."""

REACH = 3.0
"""Views by which a robot moves on between two images, about, before its drive tells."""

FARTHEST = 30
"""Views beyond which a move counts as a jump."""

SUPPOSED, REMEMBERED = 2.0, 0.95
"""Moves that what is supposed of a robot is worth, and how much of what was learnt of its moves is kept an image."""

JUMP, LEAVE, ENTER = 0.02, 0.2, 0.05
"""Probability between two images of a jump to anywhere on the map, of leaving it, and of coming onto it. That of
leaving is high so that a drive soon stops vouching for images that do not vouch for themselves."""

RESEMBLES, LASTING = 0.3, 0.9
"""Probability that what is not on the map looks like a view of it, and that it still does in the next image."""

CHANGE = 0.02
"""Probability between two images that a walk becomes a jumble of images, or the other way round."""

TEMPERED = 0.8
"""Power of the odds of an image's first place: consecutive images err alike, so each says less than one alone."""

OTHERS = 0.3
"""Share of the probability that an image does not show its first place which its other candidates get together. A path
leads on through images whose right view is not first; the more they get, the longer also through what is not on the
map."""

SHARPNESS = 2.0
"""By how many gaps of wrong answers a score must be higher for the view to be e times as likely."""

MOST_SURE = 1 - 1e-9
"""Largest probability of a first place that is read: the odds of certainty are infinite."""

KEPT, LEAST = 256, 1e-5
"""Views whose probability is kept one by one, at most, and the least that is kept; all others share what is left
evenly."""


def supposed() -> Doubles:
    """Weights of moves by -FARTHEST..FARTHEST views before anything is known, float64 (2 FARTHEST + 1,).

    A Cauchy distribution, so that a robot that stands, one that races, and one that turns round are all followed.
    """
    whole = np.arange(-FARTHEST, FARTHEST + 1)
    weights = 1 / (1 + (whole / REACH) ** 2)
    return np.asarray(SUPPOSED * weights / weights.sum())


@dataclass(frozen=True, eq=False)
class Drive:
    """What the images of a drive say together.

    Parameters
    ----------
    seqs : int64 of shape (n,)
        Views, ascending.
    order : int64 of shape (n,)
        How many views of the map were enrolled before each of them.
    walked : float64 of shape (n,)
        That the newest image shows what each view does, if the drive is a walk. The rest to 1: another view of the map
        (`elsewhere`), or none (`nowhere`).
    alike : float64 of shape (n,)
        Of `nowhere`: that what the image shows is not on the map, and looks like each view.
    elsewhere, nowhere : float
    moves : float64 of shape (2 FARTHEST + 1,)
        How often the robot moved on by -FARTHEST..FARTHEST views, as far as that is known.
    coherence : float
        Probability that the drive is a walk.
    images : int
    """

    seqs: Sequence64 = field(default_factory=lambda: np.zeros(0, np.int64))
    order: Sequence64 = field(default_factory=lambda: np.zeros(0, np.int64))
    walked: Doubles = field(default_factory=lambda: np.zeros(0))
    alike: Doubles = field(default_factory=lambda: np.zeros(0))
    moves: Doubles = field(default_factory=supposed)
    elsewhere: float = KNOWN
    nowhere: float = 1 - KNOWN
    coherence: float = 0.5
    images: int = 0


@dataclass(frozen=True, eq=False)
class Single:
    """What one image says on its own.

    Parameters
    ----------
    seqs : int64 of shape (m,)
        Its candidates, ascending.
    order : int64 of shape (m,)
        How many views of the map were enrolled before each of them.
    probabilities : float64 of shape (m,)
        That it shows what each of them does; above 0.
    searched : int
        Views that could have been candidates.
    """

    seqs: Sequence64
    order: Sequence64
    probabilities: Doubles
    searched: int

    @property
    def none(self) -> float:
        """Probability that it shows none of them, never 0."""
        return max(1 - float(self.probabilities.sum()), 1e-6)


def spread(scores: Doubles, first: Booleans, sure: float, gap: float) -> Doubles:
    """Share the tempered probability of an image's first place among its views, and some of the rest among the others.

    Parameters
    ----------
    scores : float64 of shape (m,)
        Of the candidates.
    first : bool of shape (m,)
        Views of the first place.
    sure : float
        Probability of the first place, by this image alone.
    gap : float
        By which wrong answers exceed each other in this map.

    Returns
    -------
    float64 of shape (m,)
        What is missing to 1 is the probability of none.
    """
    weights = np.exp((scores - scores.max()) / (SHARPNESS * gap))
    shared = np.zeros(len(scores))
    sure = min(sure, MOST_SURE)
    odds = (sure / (1 - sure)) ** TEMPERED
    sure = odds / (1 + odds)
    for views, mass in ((first, sure), (~first, OTHERS * (1 - sure))):
        if views.any():
            shared[views] = mass * weights[views] / weights[views].sum()
    return np.maximum(shared, 1e-12)


def follow(drive: Drive, single: Single) -> tuple[Drive, Doubles]:
    """A drive with one more image, and what all of its images say of the newest one.

    Returns
    -------
    Drive
    float64 of shape (m,)
        Probability of each candidate of `single`; what is missing to 1 is that of everything else.
    """
    count = max(single.searched, len(single.seqs), 1)
    alone = np.full(len(single.seqs), KNOWN / count)
    ratios = single.probabilities / alone / (single.none / (1 - float(alone.sum())))
    drive = shortened(drive)
    seqs, rows = np.unique(np.concatenate([single.seqs, drive.seqs]), return_index=True)
    order = np.concatenate([single.order, drive.order])[rows]
    here, before = np.searchsorted(seqs, single.seqs), np.searchsorted(seqs, drive.seqs)
    ratio, resemblance, alike = np.ones(len(seqs)), np.zeros(len(seqs)), np.zeros(len(seqs))
    ratio[here] = ratios
    resemblance[here] = count * single.probabilities / max(float(single.probabilities.sum()), 1e-12)
    if drive.images == 0:
        arrived, elsewhere, nowhere = np.full(len(seqs), KNOWN / count), KNOWN - KNOWN / count * len(seqs), 1 - KNOWN
    else:
        arrived, elsewhere, nowhere = predict(drive, order, count)
        alike[before] = (1 - ENTER) * LASTING * drive.alike
    weighed = arrived * ratio
    unlike = nowhere - float(alike.sum())
    alike = (alike + unlike * RESEMBLES / count) * resemblance
    nowhere = unlike * (1 - RESEMBLES) + float(alike.sum())
    foretold = float(weighed.sum()) + elsewhere + nowhere
    coherence, moves = drive.coherence, drive.moves
    if drive.images:
        coherence = walking(coherence, foretold, float((alone * ratios).sum()) + 1 - float(alone.sum()))
        moves = learnt(drive, order, coherence * ratio / foretold)
    walked = weighed / foretold
    followed = Drive(
        seqs=seqs,
        order=order,
        walked=walked,
        alike=alike / foretold,
        moves=moves,
        elsewhere=max(elsewhere, 0.0) / foretold,
        nowhere=nowhere / foretold,
        coherence=coherence,
        images=drive.images + 1,
    )
    together = coherence * walked[here] + (1 - coherence) * single.probabilities
    return followed, together


def walking(coherence: float, foretold: float, by_chance: float) -> float:
    """Probability that a drive is a walk, after one more image.

    Parameters
    ----------
    coherence : float
        That probability before the image.
    foretold, by_chance : float
        How likely the image is if the drive is a walk, and if each image is of anywhere.
    """
    walks = coherence * (1 - CHANGE) + (1 - coherence) * CHANGE
    return walks * foretold / (walks * foretold + (1 - walks) * by_chance)


def shortened(drive: Drive) -> Drive:
    """A drive without the views that hardly count."""
    weight = drive.walked + drive.alike
    kept = np.sort(np.argsort(-weight, kind="stable")[:KEPT])
    kept = kept[weight[kept] > LEAST]
    gone = float(drive.walked.sum() - drive.walked[kept].sum())
    return replace(
        drive,
        seqs=drive.seqs[kept],
        order=drive.order[kept],
        walked=drive.walked[kept],
        alike=drive.alike[kept],
        elsewhere=drive.elsewhere + gone,
    )


def predict(drive: Drive, order: Sequence64, count: int) -> tuple[Doubles, float, float]:
    """Where a walk is when its next image is taken, before that is looked at.

    Parameters
    ----------
    drive : Drive
    order : int64 of shape (n,)
        Of the views of interest.
    count : int
        Views of the map.

    Returns
    -------
    (float64 of shape (n,), float, float)
        Probability of each view, of the others of the map together, and of none. They sum to 1.
    """
    on_map = float(drive.walked.sum()) + drive.elsewhere
    moved = drive.walked @ kernel(drive.moves, order[None, :] - drive.order[:, None])
    stays = (1 - LEAVE) * on_map + ENTER * drive.nowhere
    anywhere = (1 - LEAVE) * (JUMP * (on_map - drive.elsewhere) + drive.elsewhere) + ENTER * drive.nowhere
    arrived = (1 - LEAVE) * (1 - JUMP) * moved + anywhere / max(count, len(order))
    arrived *= min(1.0, stays / max(float(arrived.sum()), 1e-12))
    return arrived, stays - float(arrived.sum()), 1 - stays


def kernel(moves: Doubles, steps: Sequence64) -> Doubles:
    """Probability of a move by so many views, float64 like `steps`; 0 beyond FARTHEST."""
    within = np.abs(steps) <= FARTHEST
    shares = np.append(moves / moves.sum(), 0.0)
    return np.asarray(shares[np.where(within, steps + FARTHEST, len(moves))])


def learnt(drive: Drive, order: Sequence64, weight: Doubles) -> Doubles:
    """How often a robot moved on by how much, one image later.

    Parameters
    ----------
    drive : Drive
        Before that image.
    order : int64 of shape (n,)
        Of the views where it may be now.
    weight : float64 of shape (n,)
        By how much likelier the image made each of them, times the probability that the drive is a walk.
    """
    steps = order[None, :] - drive.order[:, None]
    taken = drive.walked[:, None] * kernel(drive.moves, steps) * ((1 - LEAVE) * (1 - JUMP) * weight)[None, :]
    within = np.abs(steps) <= FARTHEST
    seen = np.bincount(steps[within] + FARTHEST, weights=taken[within], minlength=len(drive.moves))
    return REMEMBERED * drive.moves + (1 - REMEMBERED) * supposed() + seen
