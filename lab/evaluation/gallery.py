"""Images for the report: right and wrong answers side by side, and the paper's figures made anew."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from lab.baselines.baseline import grey, orb, rgb
from lab.datasets.dataset import Dataset
from lab.evaluation.html import Example, Shown
from lab.evaluation.querying import Answers
from lab.metrics.recall import Indices, first_right
from schemas.errors import BadImage

LONG_SIDE = 420
"""Pixels of an image in the report."""

FEATURES = 500
"""ORB features of an image."""

RATIO = 0.8
"""Lowe's ratio between the best and the second best ORB match."""


class Artist(Protocol):
    """Draws what the method saw; given by whoever knows the method."""

    def explain(self, query: Path, answer: Path) -> Sequence[Shown]:
        """Context graphs of both, and what corresponds between them."""
        ...

    def portray(self, image: Path) -> Sequence[Shown]:
        """One image as the method sees it: labels, what was dropped as moving, its nodes."""
        ...


def first_answers(
    dataset: Dataset, answers: Answers, artist: Artist | None, *, each: int = 3, seed: int = 0
) -> list[Example]:
    """Some right and some wrong first answers, drawn at random from a seed.

    Drawn, not chosen: a gallery of the best cases says nothing.
    """
    truth = dataset.judged()
    first = first_right(answers.ranked, truth)
    answered = answers.ranked[:, 0] >= 0
    rng = np.random.default_rng(seed)
    examples = []
    for right, mask in ((True, first == 1), (False, truth.answerable & answered & (first != 1))):
        candidates = np.flatnonzero(mask)
        chosen = np.sort(rng.choice(candidates, min(each, len(candidates)), replace=False))
        examples += [_answer(dataset, answers, int(q), int(first[q]), right, artist) for q in chosen]
    return examples


def the_papers_figures(dataset: Dataset, answers: Answers, artist: Artist | None, seed: int = 0) -> list[Example]:
    """Where ORB puts its features against where the method puts its own, and the matches of both.

    For one query, drawn from a seed among those answered rightly (or among all, if none was).
    """
    truth = dataset.judged()
    rightly = np.flatnonzero(first_right(answers.ranked, truth) == 1)
    pool = rightly if len(rightly) else np.flatnonzero(answers.ranked[:, 0] >= 0)
    if len(pool) == 0:
        return []
    query = int(np.random.default_rng(seed).choice(pool))
    one, other = dataset.queries[query], dataset.database[int(answers.ranked[query, 0])]
    try:
        features = [Shown("ORB's 500 features, moving things included", orb_features(one))]
        matches = [orb_matches(one, other)]
    except BadImage:  # the service may read what OpenCV does not
        return []
    if artist is not None:
        features += [_smaller(shown) for shown in artist.portray(one)]
        matches += [_smaller(shown) for shown in artist.explain(one, other)]
    return [
        Example(f"Where features lie: {one.name}", None, features),
        Example(f"What is matched: {one.name} and {other.name}", None, matches),
    ]


def orb_features(path: Path) -> bytes:
    """An image with its ORB features, as JPEG."""
    keypoints, _ = orb(_fitted(grey(path)), FEATURES)
    return _jpeg(cv2.drawKeypoints(_fitted(rgb(path)), keypoints, None, (255, 60, 60)))


def orb_matches(one: Path, other: Path) -> Shown:
    """ORB's matches between two images: each the other's nearest, and clearly nearer than the next."""
    keys_a, bits_a = orb(_fitted(grey(one)), FEATURES)
    keys_b, bits_b = orb(_fitted(grey(other)), FEATURES)
    good = []
    if bits_a is not None and bits_b is not None:
        back = {(m.trainIdx, m.queryIdx) for m in cv2.BFMatcher(cv2.NORM_HAMMING).match(bits_b, bits_a)}
        for pair in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(bits_a, bits_b, k=2):
            clear = len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance
            if clear and (pair[0].queryIdx, pair[0].trainIdx) in back:
                good.append(pair[0])
    drawn = cv2.drawMatches(_fitted(rgb(one)), keys_a, _fitted(rgb(other)), keys_b, good, None, flags=2)
    return Shown(f"ORB: {len(good)} mutual matches with ratio below {RATIO}", _jpeg(drawn), wide=True)


def thumbnail(path: Path) -> bytes:
    """An image small enough for a report, as JPEG."""
    return _jpeg(_fitted(rgb(path)))


def _answer(dataset: Dataset, answers: Answers, query: int, first: int, right: bool, artist: Artist | None) -> Example:
    one = dataset.queries[query]
    answer = dataset.database[int(answers.ranked[query, 0])]
    images = [*_shown(f"query {one.name}", one), *_shown(f"answer {answer.name}", answer)]
    if not right:
        positives: Indices = dataset.positives[query]
        wanted = dataset.database[int(positives[len(positives) // 2])]
        images += _shown(f"a right answer {wanted.name}", wanted)
    if artist is not None:
        images += [_smaller(shown) for shown in artist.explain(one, answer)]
    rank = "" if right else f", first right answer at rank {first}" if first else ", no right answer among those given"
    confidence = (
        f", confidence {answers.confidence[query]:.2f}" if answers.calibrated and answers.confidence is not None else ""
    )
    return Example(f"{answers.method}, query {query}{rank}{confidence}", right, images)


def _shown(caption: str, path: Path) -> list[Shown]:
    """An image with what it shows, which says so where it cannot be decoded."""
    try:
        return [Shown(caption, thumbnail(path))]
    except BadImage:
        return [
            Shown(f"{caption}, which cannot be decoded", _jpeg(np.full((LONG_SIDE // 2, LONG_SIDE), 128, np.uint8)))
        ]


def _smaller(shown: Shown) -> Shown:
    """A drawing small enough for a report: those of an artist are as large as the photo and losslessly packed."""
    pixels = cv2.imdecode(np.frombuffer(shown.data, np.uint8), cv2.IMREAD_COLOR_RGB)
    scale = min(1.0, 2 * LONG_SIDE / max(pixels.shape[:2]))
    size = (round(pixels.shape[1] * scale), round(pixels.shape[0] * scale))
    return replace(shown, data=_jpeg(np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)))


def _fitted(pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """An image whose longer side is `LONG_SIDE`."""
    scale = LONG_SIDE / max(pixels.shape[:2])
    size = (max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale)))
    smaller = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    return np.asarray(smaller, np.uint8)


def _jpeg(pixels: npt.NDArray[np.uint8]) -> bytes:
    """RGB or grey pixels as JPEG."""
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[:, :, ::-1])
    fine, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 82])
    if not fine:
        raise ValueError(f"an image of shape {pixels.shape} cannot be encoded")
    return bytes(data)
