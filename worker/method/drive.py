"""Drives: evidence of consecutive images adds up, by a Bayes filter over the views of a map and "nowhere".

The discrete filter of Markov localisation (Thrun, Burgard, Fox: Probabilistic Robotics, 2005, section 8.2), with two
models of motion beside each other. By the first, the next image is taken a few views further along the order of
enrolment; by the second, anywhere. How well each foretold the images so far decides how much it counts: on a walk the
first soon has nearly all the weight, and with shuffled images the answer is that of the single image.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

KNOWN = 0.7
"""Probability that an image shows something of the map, before anything is known."""

REACH = 3.0
"""Views by which a robot moves on between two images, about."""

FARTHEST = 30
"""Views beyond which a move counts as a jump."""

JUMP, LEAVE, ENTER = 0.02, 0.3, 0.05
"""Probability between two images of a jump to anywhere on the map, of leaving it, and of coming onto it. That of
leaving is high so that a drive soon stops vouching for images that do not vouch for themselves."""

CHANGE = 0.05
"""Probability between two images that a walk becomes a jumble of images, or the other way round."""

SHARPNESS = 2.0
"""By how many gaps of wrong answers a score must be higher for the view to be e times as likely."""

KEPT = 256
"""Views whose probability is kept one by one; all others share what is left evenly."""


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
    elsewhere, nowhere : float
    coherence : float
        Probability that the drive is a walk.
    images : int
    """

    seqs: Integers = field(default_factory=lambda: np.zeros(0, np.int64))
    order: Integers = field(default_factory=lambda: np.zeros(0, np.int64))
    walked: Doubles = field(default_factory=lambda: np.zeros(0))
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

    seqs: Integers
    order: Integers
    probabilities: Doubles
    searched: int

    @property
    def none(self) -> float:
        """Probability that it shows none of them, never 0."""
        return max(1 - float(self.probabilities.sum()), 1e-6)


def spread(scores: Doubles, first: npt.NDArray[np.bool_], sure: float, none: float, gap: float) -> Doubles:
    """Share the probabilities of a single image's places among their views.

    Parameters
    ----------
    scores : float64 of shape (m,)
        Of the candidates.
    first : bool of shape (m,)
        Views of the first place.
    sure, none : float
        Probability of the first place, and that of no place.
    gap : float
        By which wrong answers exceed each other in this map.

    Returns
    -------
    float64 of shape (m,)
        Sums to 1 - `none`.
    """
    weights = np.exp((scores - scores.max()) / (SHARPNESS * gap))
    shared = np.zeros(len(scores))
    rest = max(1 - sure - none, 0.0)
    for views, mass in ((first, sure), (~first, rest)):
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
    kept = np.argsort(-drive.walked, kind="stable")[:KEPT]
    seqs, rows = np.unique(np.concatenate([single.seqs, drive.seqs[kept]]), return_index=True)
    order = np.concatenate([single.order, drive.order[kept]])[rows]
    ratio = np.ones(len(seqs))
    ratio[np.searchsorted(seqs, single.seqs)] = ratios
    if drive.images == 0:
        arrived, elsewhere, nowhere = np.full(len(seqs), KNOWN / count), KNOWN - KNOWN / count * len(seqs), 1 - KNOWN
    else:
        arrived, elsewhere, nowhere = predict(drive, order, count)
    weighed = arrived * ratio
    foretold = float(weighed.sum()) + elsewhere + nowhere
    coherence = drive.coherence
    if drive.images:
        by_chance = float((alone * ratios).sum()) + 1 - float(alone.sum())
        walks = coherence * (1 - CHANGE) + (1 - coherence) * CHANGE
        coherence = walks * foretold / (walks * foretold + (1 - walks) * by_chance)
    walked = weighed / foretold
    followed = Drive(
        seqs, order, walked, max(elsewhere, 0.0) / foretold, nowhere / foretold, coherence, drive.images + 1
    )
    together = coherence * walked[np.searchsorted(seqs, single.seqs)] + (1 - coherence) * single.probabilities
    return followed, together


def predict(drive: Drive, order: Integers, count: int) -> tuple[Doubles, float, float]:
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
    moved = drive.walked @ kernel(np.abs(drive.order[:, None] - order[None, :]))
    stays = (1 - LEAVE) * on_map + ENTER * drive.nowhere
    anywhere = (1 - LEAVE) * (JUMP * (on_map - drive.elsewhere) + drive.elsewhere) + ENTER * drive.nowhere
    arrived = (1 - LEAVE) * (1 - JUMP) * moved + anywhere / max(count, len(order))
    arrived *= min(1.0, stays / max(float(arrived.sum()), 1e-12))
    return arrived, stays - float(arrived.sum()), 1 - stays


def kernel(steps: Integers) -> Doubles:
    """Probability of a move over so many views, forwards or backwards; float64 like `steps`.

    A Cauchy distribution, so that a robot that stands, one that races, and one that turns round are all followed.
    """
    whole = np.arange(-FARTHEST, FARTHEST + 1)
    total = (1 / (1 + (whole / REACH) ** 2)).sum()
    return np.where(steps <= FARTHEST, 1 / (1 + (steps / REACH) ** 2) / total, 0.0)
