from pathlib import Path

import numpy as np
import pytest
import torch

from tests.training.tokens import cache
from training.data.crop_batches import CropBatches, find_scenes
from training.data.teacher_space import TeacherSpace


@pytest.fixture
def batches(data_folder: Path, tmp_path: Path) -> CropBatches:
    tokens = cache(data_folder, tmp_path)
    space = TeacherSpace.fit(sorted(tokens.glob("*.npy")), 8)
    return CropBatches(find_scenes(data_folder), data_folder, tokens, space, pairs=3, seed=5)


def test_a_batch_depends_on_seed_and_step_alone(batches: CropBatches) -> None:
    once, again, other = batches[4], batches[4], batches[5]

    assert all(torch.equal(once[name], again[name]) for name in once)
    assert not torch.equal(once["images"], other["images"])
    assert once["images"].shape == (6, 3, 256, 256)
    assert once["targets"].shape == (6, 8, 16, 16)
    lengths = once["targets"].float().norm(dim=1)
    assert torch.allclose(lengths, torch.ones_like(lengths), atol=2e-3)


def test_corresponding_cells_have_the_same_tokens(batches: CropBatches) -> None:
    # The images are smaller than `crops.LEAST_SIDE`: each gives one crop, so that both views of a pair show the same.
    batch = batches[0]

    assert batch["matched"].all()
    rows, columns = batch["cells"] // 16, batch["cells"] % 16
    x = (columns + 0.5) / 16 * 2 - 1
    y = (rows + 0.5) / 16 * 2 - 1
    assert torch.allclose(batch["positions"], torch.stack([x, y], dim=2).float(), atol=1e-5)
    first, second = batch["targets"].float().chunk(2)
    assert torch.equal(first, second)  # of the square by day and by night, too: both learn the mean


def test_components_count_by_the_root_of_their_deviation(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    tokens = rng.standard_normal((60, 1, 8, 8, 3)) * [100, 10, 1]
    for number, crops in enumerate(tokens):
        np.save(tmp_path / f"{number}.npy", crops.astype(np.float16))

    space = TeacherSpace.fit(sorted(tmp_path.glob("*.npy")), 3)

    deviations = ((tokens.reshape(-1, 3) - space.mean) @ space.matrix).std(axis=0)
    assert deviations == pytest.approx([10, 10**0.5, 1], rel=0.1)


def test_a_fitted_space_is_read_back(batches: CropBatches, tmp_path: Path) -> None:
    batches.space.save(tmp_path / "space.npz")
    again = TeacherSpace.load(tmp_path / "space.npz")

    assert np.array_equal(again.matrix, batches.space.matrix)
    assert np.array_equal(again.mean, batches.space.mean)
    assert again.side == 16
