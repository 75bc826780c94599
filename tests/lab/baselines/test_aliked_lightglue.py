"""ALIKED and LightGlue: what files are read, and what the real ones find on drawn places."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from lab.baselines.aliked_lightglue import ALIKED, LIGHTGLUE, AlikedLightGlue
from lab.evaluation.querying import ranked_by
from lab.evaluation.reranking import Reranking
from schemas.errors import SetupError
from tests.lab.baselines.rivals import as_dataset, enrolled_and_queried, weights


class FakeAliked(torch.nn.Module):
    """Keypoints on a grid; descriptors are what the image shows around them."""

    def __init__(self, name: str, **given: Any) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(1))
        self.register_buffer("derived", torch.zeros(1))

    def forward(self, images: torch.Tensor) -> list[SimpleNamespace]:
        rows, columns = torch.meshgrid(torch.arange(8, 88, 8), torch.arange(8, 88, 8), indexing="ij")
        spots = torch.stack([columns, rows], dim=-1).reshape(-1, 2)
        return [SimpleNamespace(keypoints=spots.float(), descriptors=images[0, :, spots[:, 1], spots[:, 0]].T)]


class FakeLightGlue(torch.nn.Module):
    """Matches descriptors that are equal; one weight, in the layer where the authors' file has it elsewhere."""

    def __init__(self, features: str | None, input_dim: int) -> None:
        super().__init__()
        assert features is None, "a name would have the weights downloaded"
        layer = torch.nn.Module()
        layer.self_attn = torch.nn.Linear(1, 1, bias=False)
        self.transformers = torch.nn.ModuleList([layer])

    def forward(self, pair: dict[str, Any]) -> dict[str, Any]:
        first, second = pair["image0"]["descriptors"][0], pair["image1"]["descriptors"][0]
        same = (first[:, None] == second).all(dim=-1)
        return {"matches": [same.nonzero()]}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Weights of the fake networks, in the authors' layout."""
    fake = ModuleType("kornia.feature")
    fake.__dict__.update(ALIKED=FakeAliked, LightGlue=FakeLightGlue)
    monkeypatch.setitem(sys.modules, "kornia", ModuleType("kornia"))
    monkeypatch.setitem(sys.modules, "kornia.feature", fake)
    torch.save({"scale": torch.ones(1)}, tmp_path / ALIKED)
    torch.save({"self_attn.0.weight": torch.full((1, 1), 7.0)}, tmp_path / LIGHTGLUE)
    return tmp_path


def image(path: Path, seed: int) -> Path:
    pixels = np.random.default_rng(seed).integers(0, 255, (480, 480, 3), dtype=np.uint8)
    assert cv2.imwrite(str(path), pixels)
    return path


def test_a_pair_is_matched_once_and_counted_by_its_geometry(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    verifier = AlikedLightGlue(folder)
    one, other = image(folder / "one.png", 1), image(folder / "other.png", 2)
    calls: list[int] = []
    matches = verifier.matches
    monkeypatch.setattr(verifier, "matches", lambda *pair: calls.append(1) or matches(*pair))  # type: ignore[func-returns-value]
    assert verifier.inliers(one, one) == verifier.inliers(one, one) > 50
    assert len(calls) == 1
    assert verifier.inliers(one, other) == 0


def test_positions_are_fractions_of_the_longer_side(folder: Path) -> None:
    verifier = AlikedLightGlue(folder, side=480)
    features = verifier.describe(image(folder / "one.png", 1))
    source, target = verifier.matches(features, features)
    assert source.dtype == np.float32
    assert source[0].tolist() == target[0].tolist() == pytest.approx([8 / 480, 8 / 480])
    assert features.size.tolist() == [[480, 480]]


def test_layers_of_the_authors_file_find_their_place(folder: Path) -> None:
    matcher: Any = AlikedLightGlue(folder)._matcher
    assert matcher.transformers[0].self_attn.weight.item() == 7


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: (folder / ALIKED).unlink(), rf"{ALIKED}: there is no such file.*says where"),
        (lambda folder: (folder / LIGHTGLUE).write_text("none"), rf"{LIGHTGLUE} cannot be read as weights"),
        (lambda folder: torch.save({}, folder / ALIKED), rf"{ALIKED} does not fit: scale"),
        (lambda folder: torch.save({"scale": torch.ones(1), "more": torch.ones(1)}, folder / ALIKED), "fit: more"),
        (lambda folder: torch.save({"scale": torch.ones(2)}, folder / ALIKED), rf"{ALIKED} cannot be read"),
    ],
)
def test_files_that_cannot_be_used_are_explained(folder: Path, spoil: Any, says: str) -> None:
    spoil(folder)
    with pytest.raises(SetupError, match=says):
        AlikedLightGlue(folder)


@pytest.mark.slow
def test_the_real_networks_put_the_right_place_first(tmp_path: Path) -> None:
    file, _ = weights(ALIKED, LIGHTGLUE)
    pytest.importorskip("kornia.feature", reason="NOT RUN: needs the package kornia: pip install kornia")
    database, queries = enrolled_and_queried(tmp_path)
    dataset, backwards = as_dataset(database, queries[:2]), np.tile(np.array([4, 3, 2, 1], np.float32), (2, 1))
    verifier = AlikedLightGlue(file.parent)
    found = Reranking(verifier, "backwards", 4).reranked(dataset, ranked_by(backwards, dataset, "backwards"))
    assert found.ranked[:, 0].tolist() == [0, 1]
