"""Rivals on drawn places: seen from another spot, each finds them again, the same way every time."""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.baselines.anyloc import AnyLoc
from lab.baselines.baseline import Baseline
from lab.baselines.colmap_tree import ColmapTree, as_bytes
from lab.baselines.dinov2 import BLOCK as TEACHERS
from lab.baselines.known import Needs, rivals
from lab.baselines.rootsift_vlad import FIRST, RootSift, RootSiftVlad
from lab.evaluation.querying import ranked_by
from lab.evaluation.reranking import Reranking
from schemas.errors import InvalidParameters, SetupError
from tests.lab.baselines.rivals import DINOV2, as_dataset, enrolled_and_queried, weights
from tests.training.tokens import write_teacher


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], list[Path]]:
    return enrolled_and_queried(tmp_path_factory.mktemp("rivals"))


def finds(baseline: Baseline, database: Sequence[Path], queries: Sequence[Path]) -> list[int]:
    """First answers; counts the images, and asks twice."""
    ticks: list[int] = []
    distances = baseline.rank(database, queries, lambda: ticks.append(1))
    assert len(ticks) == len(database) + len(queries)
    assert distances.shape == (len(queries), len(database))
    assert distances.dtype == np.float32
    assert np.array_equal(distances, baseline.rank(database, queries, lambda: None))
    return [int(image) for image in distances.argmin(axis=1)]


def test_rootsift_vlad_finds_places_from_another_spot(places: tuple[list[Path], list[Path]]) -> None:
    assert finds(RootSiftVlad(RootSift()), *places) == [0, 1, 2, 3]


def test_inliers_put_the_right_place_first_whatever_the_order_before(places: tuple[list[Path], list[Path]]) -> None:
    database, queries = places
    dataset, backwards = as_dataset(database, queries), np.tile(np.array([4, 3, 2, 1], np.float32), (4, 1))
    answers = ranked_by(backwards, dataset, "backwards")
    assert answers.ranked[:, 0].tolist() == [3] * 4

    verified = Reranking(RootSift(), "backwards", 4).reranked(dataset, answers)

    assert verified.ranked[:, 0].tolist() == [0, 1, 2, 3]
    assert verified.method == "backwards, verified"
    assert verified.confidence is not None
    assert verified.confidence.min() > 20, "inliers of the first answer"
    assert not verified.calibrated


def test_rootsift_brings_its_verification_and_finds_keypoints_once() -> None:
    made = rivals(["rootsift", "tiny"], Needs())
    [again] = made.rerankings
    assert (again.of, again.first) == ("rootsift vlad", FIRST)
    vlad = made.baselines[0]
    assert isinstance(vlad, RootSiftVlad)
    assert again.verifier is vlad.features


def test_an_image_without_keypoints_is_like_nothing(places: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    fog = tmp_path / "fog.png"
    assert cv2.imwrite(str(fog), np.full((96, 128), 128, np.uint8))
    database, _ = places
    distances = RootSiftVlad(RootSift()).rank(database, [fog], lambda: None)
    assert np.isfinite(distances).all()
    assert np.ptp(distances) < 1e-5
    assert RootSift().inliers(fog, database[0]) == 0


def test_anyloc_compares_tokens_wherever_they_are(tmp_path: Path) -> None:
    """By a drawn network, whose tokens are mean colours: what counts is which there are, not where."""
    palette = np.random.default_rng(0).integers(0, 255, (4, 6, 3))
    database: list[Path] = []
    queries: list[Path] = []
    for number, colours in enumerate(palette):
        for files, name, seed in ((database, "d", 1), (queries, "q", 2)):
            order = np.random.default_rng(seed).integers(0, 6, (16, 16))
            files.append(tmp_path / f"{name}{number}.png")
            blocks = np.kron(colours[order], np.ones((14, 14, 1))).astype(np.uint8)
            assert cv2.imwrite(str(files[-1]), blocks)
    anyloc = AnyLoc(write_teacher(tmp_path / "teacher.onnx"), block=TEACHERS, words=8)
    assert finds(anyloc, database, queries) == [0, 1, 2, 3]


def test_anyloc_finds_places_by_the_weights_of_dinov2(places: tuple[list[Path], list[Path]]) -> None:
    [file] = weights(DINOV2)
    assert finds(AnyLoc(file, words=8), *places) == [0, 1, 2, 3]


def test_colmaps_tree_finds_places_from_another_spot(places: tuple[list[Path], list[Path]]) -> None:
    pytest.importorskip("pycolmap", reason="NOT RUN: needs the package pycolmap: pip install pycolmap")
    assert finds(ColmapTree(RootSift()), *places) == [0, 1, 2, 3]


def test_descriptors_as_colmap_stores_them() -> None:
    root = np.array([[0.0, 0.25, 0.6]], np.float32)
    assert as_bytes(root).tolist() == [[0, 128, 255]]


def test_packages_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from lab.baselines.aliked_lightglue import AlikedLightGlue

    for name in ("pycolmap", "kornia", "kornia.feature"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(SetupError, match="pip install pycolmap"):
        rivals(["colmap"], Needs())
    with pytest.raises(SetupError, match="pip install kornia"):
        AlikedLightGlue(tmp_path)


def test_weights_that_are_missing_are_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameters, match="--dinov2 FILE"):
        rivals(["anyloc"], Needs())
    with pytest.raises(SetupError, match=r"none\.onnx: there is no such file.*says where"):
        rivals(["anyloc"], Needs(dinov2=tmp_path / "none.onnx"))
