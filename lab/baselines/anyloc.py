"""AnyLoc's way (Keetha et al. 2023): VLAD over tokens of a network that was trained for nothing in particular.

The smallest of its networks, DINOv2 ViT-S/14, at the one size that its file takes. AnyLoc itself reads the values of a
late block of ViT-G/14 at the image's own size, 49,152 numbers: what is measured here is the small one.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from lab.baselines.baseline import Tick, euclidean, rgb
from lab.baselines.dinov2 import CHANNELS, SIZE, DinoV2
from lab.baselines.vlad import learn_words, vlad
from schemas.description import Floats
from worker.method.unit_length import unit

BLOCK = 10
"""Whose tokens are read: the best of 6, 8, 9, 10 and 11 on every other query of a corridor and a campus together."""

WORDS = 32


class AnyLoc:
    """Euclidean distance between VLAD vectors of DINOv2's tokens.

    Parameters
    ----------
    weights : Path
        ONNX file of the network.
    block : int
        Whose tokens are read, 0..11.
    words : int
        Size of the vocabulary, learned from the database alone.
    seed : int
    threads : int

    Raises
    ------
    SetupError
        As `DinoV2`.
    """

    name = "dinov2-s vlad"

    def __init__(self, weights: Path, block: int = BLOCK, words: int = WORDS, seed: int = 0, threads: int = 1) -> None:
        self.network, self.words, self.seed = DinoV2(weights, threads, block), words, seed

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database)."""
        known = [self._tokens(path, tick) for path in database]
        words = learn_words(known, self.words, self.seed)
        vectors = np.stack([vlad(tokens, words, signed_roots=False) for tokens in known])
        queried = np.stack([vlad(self._tokens(path, tick), words, signed_roots=False) for path in queries])
        return euclidean(vectors, queried)

    def _tokens(self, path: Path, tick: Tick) -> Floats:
        """Tokens of an image, squeezed to a square; float32 (256, 384), unit length."""
        square = cv2.resize(rgb(path), (SIZE, SIZE), interpolation=cv2.INTER_AREA)
        tokens = self.network.tokens(np.asarray(square, np.uint8))
        tick()
        return unit(tokens.reshape(-1, CHANNELS).astype(np.float32))
