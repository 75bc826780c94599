"""SeqSLAM: sequences of images instead of single ones (Milford and Wyeth, ICRA 2012). Our own code, from the paper.

A walk is recognised by how it looks over ten images, of which each by itself says next to nothing. The database must be
in the order of its path and driven the same way at about the same speed; queries must be in order too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from lab.baselines.baseline import Tick, city_block, described, grey
from lab.baselines.tiny import normalised
from lab.metrics.recall import Indices
from schemas.description import Doubles, Floats

WIDTH, HEIGHT = 64, 32

LENGTH = 10
"""Images of a sequence: the query and those before it."""

WINDOW = 10
"""Database images among which a difference is told from its surroundings, and within which no rival is sought.

As published. Where images follow each other so closely that ten of them show one place, local contrast takes away what
tells the place; without it SeqSLAM is better on such walks.
"""

SPEEDS = np.linspace(0.8, 1.2, 5)
"""Database images that go by for each query image."""

CLAIMED = 0.9
"""Largest quotient of the best score and the best one elsewhere at which a place is claimed."""


@dataclass(frozen=True, eq=False)
class Matched:
    """What each query is taken for.

    Parameters
    ----------
    image : int64 of shape (queries,)
        Database index.
    quotient : float64 of shape (queries,)
        Its score over the best one outside its window, 0..1, small where it is unique; 1 where nothing lies outside.
    """

    image: Indices
    quotient: Doubles


class SeqSlam:
    """Distances of sequences that end with the query.

    Parameters
    ----------
    length : int
        Images of a sequence.
    local_contrast : bool
        Whether differences are told from those around them, as published.
    """

    def __init__(self, length: int = LENGTH, *, local_contrast: bool = True) -> None:
        self.length, self.local_contrast = length, local_contrast

    @property
    def name(self) -> str:
        """As it stands in tables."""
        return "seqslam" if self.local_contrast else "seqslam without local contrast"

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database), of 0 and more; both in the order of their path."""
        known, queried = described(database, thumbnail, tick), described(queries, thumbnail, tick)
        differences = city_block(known, queried)
        return sequence_scores(enhanced(differences) if self.local_contrast else differences, self.length)


def thumbnail(path: Path) -> Floats:
    """An image as float32 (2048,): 64 x 32 grey, each patch of 8 x 8 with mean 0 and deviation 1."""
    return normalised(cv2.resize(grey(path), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))


def enhanced(differences: Floats, window: int = WINDOW) -> Floats:
    """Each difference against those with the images around the same database image.

    Parameters
    ----------
    differences : float32 of shape (queries, database)
    window : int

    Returns
    -------
    float32 of shape (queries, database)
        Less the mean, over the deviation, of the window, which is cut off at the ends; then less the least of all, so
        that quotients have a meaning.
    """
    count = differences.shape[1]
    local = np.zeros_like(differences)
    for image in range(count):
        around = differences[:, max(0, image - window // 2) : min(count, image + window // 2 + 1)]
        spread = np.maximum(around.std(axis=1), 1e-6)
        local[:, image] = (differences[:, image] - around.mean(axis=1)) / spread
    return np.asarray(local - local.min(initial=0), np.float32)


def sequence_scores(differences: Floats, length: int = LENGTH, speeds: Doubles = SPEEDS) -> Floats:
    """Mean difference along the best straight line that ends at each pair of a query and a database image.

    Parameters
    ----------
    differences : float32 of shape (queries, database)
    length : int
        Queries on a line; fewer at the beginning of the walk.
    speeds : float64 of shape (speeds,)
        Slopes of the lines that are tried.

    Returns
    -------
    float32 of shape (queries, database)

    Notes
    -----
    A line that would begin before the first database image stays at it.
    """
    queries, count = differences.shape
    images = np.arange(count)
    best = np.full((queries, count), np.inf, np.float32)
    for query in range(queries):
        back = np.arange(min(length, query + 1))
        for speed in speeds:
            at = np.maximum(images[:, None] - np.round(back * speed).astype(np.int64), 0)
            best[query] = np.minimum(best[query], differences[query - back, at].mean(axis=1))
    return best


def matched(scores: Floats, window: int = WINDOW) -> Matched:
    """The best database image for each query, and how unique it is.

    Parameters
    ----------
    scores : float32 of shape (queries, database)
        As of `sequence_scores`, 0 and more.
    window : int
    """
    images = scores.argmin(axis=1)
    quotients = np.ones(len(scores))
    for query, image in enumerate(images):
        before, after = scores[query, : max(0, image - window // 2)], scores[query, image + window // 2 + 1 :]
        rival = min(before.min(initial=np.inf), after.min(initial=np.inf))
        if 0 < rival < np.inf:
            quotients[query] = scores[query, image] / rival
    return Matched(images.astype(np.int64), quotients)
