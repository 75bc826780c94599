"""COLMAP's vocabulary tree (Schonberger et al. 2016), by its own binding, over RootSIFT keypoints.

The tree is built from the database of the set: the trees that COLMAP offers for download are not needed.
`VisualIndex.query` of the binding returns nothing (4.2.1: it fills a copy of the list that it is given), so the order
comes from `VocabTreePairGenerator`, which searches all images of a COLMAP database file. Queries lie in that file too:
they take part in how rare a word is, and are left out of the order.
"""

import importlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lab.baselines.baseline import Tick
from lab.baselines.rootsift_vlad import LONGER_SIDE, RootSift
from lab.baselines.two_views import Keypoints
from schemas.description import Floats
from schemas.errors import SetupError

WORDS = 1024
"""Visual words, at most. COLMAP takes 65,536 by default, for more images than a set has and more time."""

SHARE = 8
"""Descriptors for each word, at least."""

ITERATIONS = 10
"""Of k-means."""


class ColmapTree:
    """Ranks by COLMAP's score of visual words with Hamming embedding.

    Parameters
    ----------
    features : RootSift

    Raises
    ------
    SetupError
        The package ``pycolmap`` is not installed.
    """

    name = "colmap tree"

    def __init__(self, features: RootSift) -> None:
        self.features = features
        try:
            self._colmap: Any = importlib.import_module("pycolmap")
        except ModuleNotFoundError:
            raise SetupError("colmap needs the package pycolmap, 4.2 or newer: pip install pycolmap") from None
        self._colmap.logging.minloglevel = 2  # a line for each image otherwise

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Ranks as distances, float32 (queries, database); infinite for images that share no word with the query."""
        found = []
        for image in (*database, *queries):
            found.append(self.features.keypoints(image))
            tick()
        distances = np.full((len(queries), len(database)), np.inf, np.float32)
        with tempfile.TemporaryDirectory(prefix="revisit-colmap-") as folder:
            tree = Path(folder) / "tree.bin"
            if not self._build(found[: len(database)], tree):
                return distances
            pairs = self._searched(found, len(database), tree, Path(folder) / "database.db")
            for query, images in enumerate(pairs):
                known = [image for image in images if image < len(database)]
                distances[query, known] = np.arange(len(known))
        return distances

    def _build(self, images: Sequence[Keypoints], tree: Path) -> bool:
        """Learn the words and write them to a file; False where there is nothing to learn from."""
        descriptors = np.concatenate([as_bytes(one.descriptors) for one in images]).astype(np.float32)
        words = min(WORDS, len(descriptors) // SHARE)
        if words == 0:
            return False
        options = self._colmap.VisualIndex.BuildOptions()
        options.num_visual_words, options.num_iterations = words, ITERATIONS
        options.num_rounds, options.num_threads = 1, 1
        self._colmap.set_random_seed(0)  # of the projections of Hamming embedding
        index = self._colmap.VisualIndex.create(128, 64)
        index.build(options, self._colmap.FeatureDescriptorsFloat(self._sift, descriptors))
        index.write(str(tree))
        return True

    def _searched(self, images: Sequence[Keypoints], known: int, tree: Path, file: Path) -> list[list[int]]:
        """For each image from number `known` on, the numbers of all images that share a word with it, best first."""
        database = self._colmap.Database.open(str(file))
        camera = self._colmap.Camera.create_from_model_id(
            0, self._colmap.CameraModelId.SIMPLE_PINHOLE, LONGER_SIDE, LONGER_SIDE, LONGER_SIDE
        )
        camera_id = database.write_camera(camera)
        numbers = {}
        for number, one in enumerate(images):
            image = self._colmap.Image(name=str(number), camera_id=camera_id)
            image_id = database.write_image(image)
            numbers[image_id] = number
            database.write_keypoints(image_id, np.ascontiguousarray(one.positions * LONGER_SIDE, np.float32))
            database.write_descriptors(image_id, self._colmap.FeatureDescriptors(self._sift, as_bytes(one.descriptors)))
        options = self._colmap.VocabTreePairingOptions()
        options.vocab_tree_path, options.num_images, options.num_threads = str(tree), len(images), 1
        asking = [image_id for image_id, number in numbers.items() if number >= known]
        generator = self._colmap.VocabTreePairGenerator(options, database, asking)
        ordered: dict[int, list[int]] = {number: [] for number in range(known, len(images))}
        while not generator.has_finished():
            for one, other in generator.next():
                ordered[numbers[one]].append(numbers[other])
        return list(ordered.values())

    @property
    def _sift(self) -> Any:
        return self._colmap.FeatureExtractorType.SIFT


def as_bytes(descriptors: Floats) -> npt.NDArray[np.uint8]:
    """Unit-length RootSIFT descriptors as COLMAP stores them, uint8 of the same shape."""
    return np.clip(np.round(descriptors * 512), 0, 255).astype(np.uint8)
