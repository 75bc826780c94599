from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from training.network import TrainedNetwork
from training.start import started


def saved(folder: Path, state: dict[str, torch.Tensor]) -> Path:
    path = folder / "checkpoint.pt"
    torch.save({"average": state, "network": {}, "step": 7}, path)
    return path


def test_a_checkpoint_of_this_training_is_taken_up_whole(tmp_path: Path) -> None:
    earlier = TrainedNetwork()

    network, missing = started(saved(tmp_path, earlier.state_dict()))

    assert missing == set()
    for (name, one), other in zip(network.state_dict().items(), earlier.state_dict().values(), strict=True):
        assert torch.equal(one, other), name


def test_a_checkpoint_from_before_the_refinement_lacks_it_alone(tmp_path: Path) -> None:
    earlier = {k: v for k, v in TrainedNetwork().state_dict().items() if not k.startswith("refine.")}

    network, missing = started(saved(tmp_path, earlier))

    assert missing == {f"refine.{name}" for name, _ in network.refine.named_parameters()}
    assert torch.equal(network.words.weight, earlier["words.weight"])


def test_the_trunk_gives_its_layers_and_its_classes_are_left_out(tmp_path: Path) -> None:
    first = np.full((24, 3, 3, 3), 0.5, np.float16)
    tensors: dict[str, Any] = {"s2.0.c.weight": first, "cls.c.bias": np.zeros(19, np.float16)}
    np.savez(tmp_path / "trunk.npz", **tensors)

    network, missing = started(tmp_path / "trunk.npz")

    assert float(network.state_dict()["stride2.0.convolution.weight"].mean()) == 0.5
    assert missing == set(network.state_dict()) - {"stride2.0.convolution.weight"}


def test_a_file_of_another_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no place for"):
        started(saved(tmp_path, {"another.weight": torch.zeros(1)}))
