"""Every baseline finds an image again, and none sees more than it should."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.baselines.baseline import Baseline
from lab.baselines.hog import Hog, gradients
from lab.baselines.known import PLAIN, Needs, rivals
from lab.baselines.orb_words import OrbWords
from lab.baselines.random_order import RandomOrder
from lab.baselines.tiny import TinyImage, thumbnail
from schemas.errors import BadImage, InvalidParameters


def scene(path: Path, seed: int, light: float = 1.0) -> Path:
    """A street of drawn blocks, under some light."""
    rng = np.random.default_rng(seed)
    pixels = np.full((96, 128, 3), 90, np.uint8)
    for _ in range(25):
        x, y, w, h = rng.integers(0, 100, 4)
        cv2.rectangle(
            pixels, (int(x), int(y)), (int(x + w // 3), int(y + h // 3)), rng.integers(0, 255, 3).tolist(), -1
        )
    assert cv2.imwrite(str(path), np.clip(pixels * light, 0, 255).astype(np.uint8))
    return path


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], list[Path]]:
    root = tmp_path_factory.mktemp("scenes")
    noon = [scene(root / f"{i}_noon.png", i) for i in range(6)]
    dusk = [scene(root / f"{i}_dusk.png", i, 0.6) for i in range(6)]
    return noon, dusk


@pytest.mark.parametrize("baseline", [TinyImage(), Hog(), OrbWords(words=50)], ids=lambda b: str(b.name))
def test_places_are_known_again_at_dusk(places: tuple[list[Path], list[Path]], baseline: Baseline) -> None:
    noon, dusk = places
    distances = baseline.rank(noon, dusk, lambda: None)
    assert distances.shape == (6, 6)
    assert distances.dtype == np.float32
    assert distances.argmin(axis=1).tolist() == list(range(6))


@pytest.mark.parametrize("name", PLAIN)
def test_a_ranking_depends_on_the_seed_alone(places: tuple[list[Path], list[Path]], name: str) -> None:
    noon, dusk = places
    ticks: list[int] = []
    [one], [two] = (rivals([name], Needs(), seed=3).baselines for _ in range(2))
    a = one.rank(noon, dusk, lambda: ticks.append(1))
    assert np.array_equal(a, two.rank(noon, dusk, lambda: None))
    assert len(ticks) == 12


def test_one_query_does_not_change_the_answer_to_another(places: tuple[list[Path], list[Path]]) -> None:
    noon, dusk = places
    for baseline in (TinyImage(), Hog(), OrbWords(words=50)):
        alone = baseline.rank(noon, dusk[2:3], lambda: None)[0]
        assert alone == pytest.approx(baseline.rank(noon, dusk, lambda: None)[2], abs=1e-5)


def test_a_featureless_image_is_far_from_everything(places: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    fog = tmp_path / "fog.png"
    assert cv2.imwrite(str(fog), np.full((96, 128), 128, np.uint8))
    distances = OrbWords(words=50).rank([*places[0], fog], [fog], lambda: None)
    assert distances.tolist() == [[1.0] * 7]


@pytest.mark.parametrize("shape", [(1, 1), (1, 96), (96, 1)], ids=str)
def test_an_image_of_one_pixel_is_ranked_too(
    places: tuple[list[Path], list[Path]], tmp_path: Path, shape: tuple[int, int]
) -> None:
    speck = tmp_path / "speck.png"
    assert cv2.imwrite(str(speck), np.full(shape, 128, np.uint8))
    for one in rivals(PLAIN, Needs()).baselines:
        distances = one.rank([*places[0], speck], [speck], lambda: None)
        assert np.isfinite(distances).all()


def test_random_differs_by_seed() -> None:
    paths = [Path("a"), Path("b")]
    assert not np.array_equal(
        RandomOrder(0).rank(paths, paths, lambda: None), RandomOrder(1).rank(paths, paths, lambda: None)
    )


def test_hog_of_a_vertical_edge_by_hand() -> None:
    image = np.zeros((256, 256), np.uint8)
    image[:, 136:] = 200  # within a cell, in the middle of the image
    descriptor = gradients(image).reshape(15, 15, 4, 9)
    # The gradient points along x: angle 0 lies between the last bin and the first, half in each.
    block = descriptor[7, 7]
    assert block[0, 0] == pytest.approx(block[0, 8])
    assert block[0, 1:8] == pytest.approx(np.zeros(7))
    assert np.linalg.norm(block) == pytest.approx(1, abs=0.01)
    assert np.abs(descriptor[7, 2]).max() == 0


def test_a_thumbnail_is_normalised_patch_by_patch(tmp_path: Path) -> None:
    patches = thumbnail(scene(tmp_path / "a.png", 0)).reshape(4, 8, 4, 8)
    assert np.abs(patches.mean((1, 3))).max() < 1e-5


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameters, match="--netvlad FILE"):
        rivals(["netvlad"], Needs())
    with pytest.raises(InvalidParameters, match="--dinov2 FILE"):
        rivals(["anyloc"], Needs())
    with pytest.raises(InvalidParameters, match="there are random, tiny"):
        rivals(["sift"], Needs())
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(BadImage):
        TinyImage().rank([tmp_path / "text.png"], [], lambda: None)
