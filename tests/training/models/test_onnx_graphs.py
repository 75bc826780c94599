from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from training.models.onnx_graphs import write_fields_graph, write_independent_graph, write_segmentation_graph
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.onnx import OnnxEngine
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork
from worker.encoders.compact.torch import TorchEngine


class Files(NamedTuple):
    weights: Path
    shared: Path
    independent: Path
    fields_graph: Path
    segmentation_graph: Path
    independent_graph: Path

    @property
    def graphs(self) -> tuple[Path, ...]:
        return self[3:]


def halved(module: nn.Module) -> dict[str, Tensor]:
    return {name: tensor.half().contiguous() for name, tensor in module.state_dict().items()}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("weights")
    weights, shared_weights, independent_weights = (
        folder / f"compact{part}.safetensors" for part in ("", "-fine", "-second")
    )
    save_file(halved(CompactNetwork()) | {"text.vectors": torch.zeros(2, 97).half()}, weights)
    shared, independent = SegmentationNetwork(), IndependentSegmentationNetwork()
    for sharpen in (shared.sharpen, independent.fine.sharpen):
        for parameter in sharpen.out.parameters():
            torch.nn.init.normal_(parameter, std=0.2)  # otherwise it adds nothing
    save_file(halved(shared), shared_weights)
    save_file(halved(independent), independent_weights)
    graphs = (
        write_fields_graph(weights),
        write_segmentation_graph(weights, shared_weights),
        write_independent_graph(independent_weights),
    )
    return Files(weights, shared_weights, independent_weights, *graphs)


@pytest.mark.parametrize(("height", "width"), [(96, 128), (32, 64), (288, 480)])
def test_the_graphs_answer_like_the_networks_at_any_multiple_of_32(files: Files, height: int, width: int) -> None:
    images = np.random.default_rng(0).integers(0, 256, (2, height, width, 3), np.uint8)
    members = [files.shared.read_bytes(), files.independent.read_bytes()]
    in_torch = TorchEngine(files.weights.read_bytes(), members, "cpu")
    in_onnx = OnnxEngine(files.fields_graph, [files.segmentation_graph, files.independent_graph], threads=1)

    expected = [*in_torch.fields(images), *(in_torch.segment(images, member) for member in (0, 1))]
    answered = [*in_onnx.fields(images), *(in_onnx.segment(images, member) for member in (0, 1))]

    for one, other in zip(expected, answered, strict=True):
        assert one.shape == other.shape
        assert np.abs(one - other).max() < 1e-4


def test_the_graphs_hold_no_weights_of_their_own(files: Files) -> None:
    assert [path.name for path in files.graphs] == ["compact.onnx", "compact-fine.onnx", "compact-second.onnx"]
    for path in files.graphs:
        assert path.stat().st_size < 0.05 * files.weights.stat().st_size


def test_the_same_weights_give_the_same_graphs_to_the_byte(files: Files) -> None:
    before = [path.read_bytes() for path in files.graphs]

    again = (
        write_fields_graph(files.weights),
        write_segmentation_graph(files.weights, files.shared),
        write_independent_graph(files.independent),
    )

    assert [path.read_bytes() for path in again] == before


def test_weights_that_are_not_half_precision_are_refused(tmp_path: Path) -> None:
    save_file({name: tensor.contiguous() for name, tensor in CompactNetwork().state_dict().items()}, tmp_path / "w.st")

    with pytest.raises(ValueError, match="F32"):
        write_fields_graph(tmp_path / "w.st")
