from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from training.export_onnx import write_graphs
from worker.encoders.compact_network import CompactNetwork
from worker.encoders.compact_onnx import OnnxEngine
from worker.encoders.compact_torch import TorchEngine


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    network = CompactNetwork()
    for parameter in network.refine.out.parameters():
        torch.nn.init.normal_(parameter, std=0.2)  # otherwise it adds nothing
    state = {name: tensor.half().contiguous() for name, tensor in network.state_dict().items()}
    path = tmp_path_factory.mktemp("weights") / "compact.safetensors"
    save_file(state | {"text.vectors": torch.zeros(2, 97).half()}, path)
    return path


@pytest.fixture(scope="module")
def graphs(weights: Path) -> Mapping[str, Path]:
    return write_graphs(weights)


@pytest.mark.parametrize(("height", "width"), [(96, 128), (32, 64), (288, 480)])
def test_the_graphs_answer_like_the_network_at_any_multiple_of_32(
    weights: Path, graphs: Mapping[str, Path], height: int, width: int
) -> None:
    pictures = np.random.default_rng(0).integers(0, 256, (2, height, width, 3), np.uint8)
    in_torch, in_onnx = TorchEngine(weights.read_bytes(), "cpu"), OnnxEngine(graphs["fields"], graphs["fine"], 1)

    expected = [*in_torch.fields(pictures), in_torch.fine_words(pictures)]
    answered = [*in_onnx.fields(pictures), in_onnx.fine_words(pictures)]

    for one, other in zip(expected, answered, strict=True):
        assert one.shape == other.shape
        assert np.abs(one - other).max() < 1e-4


def test_the_graphs_hold_no_weights_of_their_own(weights: Path, graphs: Mapping[str, Path]) -> None:
    assert [path.name for path in graphs.values()] == ["compact.onnx", "compact-fine.onnx"]
    for path in graphs.values():
        assert path.stat().st_size < 0.05 * weights.stat().st_size


def test_the_same_weights_give_the_same_graphs_to_the_byte(weights: Path, graphs: Mapping[str, Path]) -> None:
    before = [path.read_bytes() for path in graphs.values()]

    assert [path.read_bytes() for path in write_graphs(weights).values()] == before


def test_weights_that_are_not_half_precision_are_refused(tmp_path: Path) -> None:
    save_file({name: tensor.contiguous() for name, tensor in CompactNetwork().state_dict().items()}, tmp_path / "w.st")

    with pytest.raises(ValueError, match="F32"):
        write_graphs(tmp_path / "w.st")
