from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from training.models.checkpoints import State
from training.models.initialization import initial_independent_network, initial_network, initial_segmentation_network
from training.models.network import TrainedNetwork


def saved(folder: Path, state: dict[str, torch.Tensor]) -> Path:
    path = folder / "checkpoint.pt"
    torch.save({"average": state, "network": {}, "step": 7}, path)
    return path


def test_a_checkpoint_of_this_training_is_taken_up_whole(tmp_path: Path) -> None:
    earlier = TrainedNetwork()

    network, missing = initial_network(saved(tmp_path, earlier.state_dict()))

    assert missing == set()
    for (name, one), other in zip(network.state_dict().items(), earlier.state_dict().values(), strict=True):
        assert torch.equal(one, other), name


def test_a_checkpoint_from_before_the_refinement_lacks_it_alone(tmp_path: Path) -> None:
    earlier = {k: v for k, v in TrainedNetwork().state_dict().items() if not k.startswith("refine.")}

    network, missing = initial_network(saved(tmp_path, earlier))

    assert missing == {f"refine.{name}" for name, _ in network.refine.named_parameters()}
    assert torch.equal(network.words.weight, earlier["words.weight"])


def test_the_trunk_gives_its_layers_and_its_classes_are_left_out(tmp_path: Path) -> None:
    first = np.full((24, 3, 3, 3), 0.5, np.float16)
    tensors: dict[str, Any] = {"s2.0.c.weight": first, "cls.c.bias": np.zeros(19, np.float16)}
    np.savez(tmp_path / "trunk.npz", **tensors)

    network, missing = initial_network(tmp_path / "trunk.npz")

    assert float(network.state_dict()["stride2.0.convolution.weight"].mean()) == 0.5
    assert missing == set(network.state_dict()) - {"stride2.0.convolution.weight"}


def test_a_file_of_another_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no place for"):
        initial_network(saved(tmp_path, {"another.weight": torch.zeros(1)}))


def test_an_independent_network_at_first_ranks_the_trunks_labels_as_the_trunk_does(trunk: State) -> None:
    vectors = F.normalize(torch.randn(19, 97), dim=1)

    independent = initial_independent_network(trunk, vectors).eval()

    image = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        shallow, fine = independent.shallow, independent.fine
        deep = fine.context(fine.deep(fine.stride16(shallow.levels(image)[2])))
        scores = F.conv2d(deep, trunk["cls.weight"], trunk["cls.bias"])
        for size in ((8, 12), (16, 24)):
            scores = F.interpolate(scores, size=size, mode="bilinear", align_corners=False)
        ranked = torch.einsum("nchw,kc->nkhw", independent(image), vectors)
    assert scores.min() > -20
    assert torch.equal(ranked.argmax(dim=1), scores.argmax(dim=1))
    order = scores[0, :, 5, 7].argsort()
    assert torch.equal(ranked[0, :, 5, 7].argsort(), order)


def test_a_network_without_some_layer_is_refused() -> None:
    network = TrainedNetwork()
    del network.stride16[0]

    with pytest.raises((ValueError, RuntimeError)):
        initial_segmentation_network(network)
