"""Exported networks as graphs for ONNX Runtime, which takes two thirds of torch's time on one thread.

The graphs take ``pictures``, uint8 of shape (n, height, width, 3), RGB, height and width multiples of 32 (padding is
fixed when a graph is traced), and give unit-length embeddings, float32 of shape (n, rows, columns, channels):

``compact.onnx``
    ``words`` and ``detail``: the semantic and the detail field of `CompactNetwork`.
``compact-fine.onnx``
    ``fine_words``: the embeddings of `SegmentationNetwork`.
``compact-second.onnx``, ``compact-third.onnx``
    ``fine_words``: the embeddings of `IndependentSegmentationNetwork`.

One graph with all outputs would be slower: ONNX Runtime computes all outputs of a graph, whichever are wanted.

No graph holds weights. They are external data in the safetensors files beside the graphs, at the offsets that the
headers of these give, float16 as they are there, and widened when a session loads. So they ship once and cannot differ
from torch's.

The names of inputs, outputs and modules are part of the files that ship, so they stay what they are.

Needs the package ``onnx``, which the service does not.
"""

import importlib
import json
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from training.models.checkpoints import load_independent_network, load_network, load_segmentation_network
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

_OPSET = 17


class FieldsGraph(nn.Module):
    """Semantic and detail field at stride 8, in the layout of the encoder."""

    def __init__(self, network: CompactNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Map uint8 (n, height, width, 3) to float (n, height / 8, width / 8, channels), twice."""
        semantic, detail = self.network(_channels_first(images))
        return semantic.permute(0, 2, 3, 1), detail.permute(0, 2, 3, 1)


class SegmentationGraph(nn.Module):
    """A segmentation network and the shallow layers that it shares, in the layout of the encoder."""

    def __init__(self, network: CompactNetwork, fine: SegmentationNetwork) -> None:
        super().__init__()
        self.network, self.fine = network, fine

    def forward(self, images: Tensor) -> Tensor:
        """Map uint8 (n, height, width, 3) to float (n, height / 4, width / 4, channels)."""
        embeddings: Tensor = self.fine(*self.network.levels(_channels_first(images)))
        return embeddings.permute(0, 2, 3, 1)


class IndependentSegmentationGraph(nn.Module):
    """An independent segmentation network, in the layout of the encoder."""

    def __init__(self, second: IndependentSegmentationNetwork) -> None:
        super().__init__()
        self.second = second

    def forward(self, images: Tensor) -> Tensor:
        """Map uint8 (n, height, width, 3) to float (n, height / 4, width / 4, channels)."""
        embeddings: Tensor = self.second(_channels_first(images))
        return embeddings.permute(0, 2, 3, 1)


def write_fields_graph(weights: Path) -> Path:
    """Write the graph of both fields beside the exported weights that it refers to.

    Raises
    ------
    ValueError
        The weights are not float16.
    """
    target = weights.with_suffix(".onnx")
    _write_graph(FieldsGraph(load_network(weights)), ("words", "detail"), {"network.": weights}, target)
    return target


def write_segmentation_graph(weights: Path, segmentation: Path) -> Path:
    """Write the graph of a segmentation network beside its exported weights; it refers to those of the network too."""
    target = segmentation.with_suffix(".onnx")
    module = SegmentationGraph(load_network(weights), load_segmentation_network(segmentation))
    _write_graph(module, ("fine_words",), {"network.": weights, "fine.": segmentation}, target)
    return target


def write_independent_graph(weights: Path) -> Path:
    """Write the graph of an independent segmentation network beside the exported weights that it refers to."""
    target = weights.with_suffix(".onnx")
    module = IndependentSegmentationGraph(load_independent_network(weights))
    _write_graph(module, ("fine_words",), {"second.": weights}, target)
    return target


def _write_graph(module: nn.Module, outputs: Sequence[str], weights: Mapping[str, Path], target: Path) -> None:
    onnx: Any = importlib.import_module("onnx")
    sizes = {"pictures": {0: "n", 1: "height", 2: "width"}}
    sizes |= {name: {0: "n", 1: "rows", 2: "columns"} for name in outputs}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the tracing exporter announces its successor
        traced = Path(folder) / "traced.onnx"
        torch.onnx.export(
            module.eval(),
            (torch.zeros(1, 96, 128, 3, dtype=torch.uint8),),
            traced,
            dynamo=False,
            opset_version=_OPSET,
            input_names=["pictures"],
            output_names=list(outputs),
            dynamic_axes=sizes,
        )
        model = onnx.load(str(traced))
    _refer_to(weights, model, onnx)
    target.write_bytes(model.SerializeToString())
    onnx.checker.check_model(str(target))


def _refer_to(weights: Mapping[str, Path], model: Any, onnx: Any) -> None:
    """Replace parameters by references into files of weights, each widened to float32 by a cast.

    Parameters
    ----------
    weights : mapping of str to Path
        For the beginning of a parameter's name, the file that holds it under the rest of the name.
    model, onnx
        Graph, changed in place, and the package.
    """
    stored = {start + name: (file, at) for start, file in weights.items() for name, at in _header(file).items()}
    inline, casts = [], []
    for tensor in model.graph.initializer:
        if tensor.name not in stored:
            inline.append(tensor)
            continue
        file, at = stored[tensor.name]
        if tuple(tensor.dims) != at.shape or at.dtype != "F16":
            raise ValueError(f"{tensor.name} is {tuple(tensor.dims)}, but {file.name} holds {at}")
        external = onnx.TensorProto(name=f"{tensor.name}.half", dims=tensor.dims, data_type=onnx.TensorProto.FLOAT16)
        external.data_location = onnx.TensorProto.EXTERNAL
        for key, value in (("location", file.name), ("offset", at.offset), ("length", at.length)):
            external.external_data.add(key=key, value=str(value))
        inline.append(external)
        casts.append(onnx.helper.make_node("Cast", [external.name], [tensor.name], to=onnx.TensorProto.FLOAT))
    nodes = casts + list(model.graph.node)
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.extend(inline)
    model.graph.node.extend(nodes)


class _Stored(NamedTuple):
    """Where a safetensors file holds a tensor, in bytes from its beginning, and of what shape and type."""

    offset: int
    length: int
    shape: tuple[int, ...]
    dtype: str


def _header(weights: Path) -> dict[str, _Stored]:
    """Read the header of a safetensors file: its length in eight bytes, then JSON; the tensors follow."""
    with weights.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
    header.pop("__metadata__", None)
    return {
        name: _Stored(8 + length + begin, end - begin, tuple(entry["shape"]), entry["dtype"])
        for name, entry in header.items()
        for begin, end in [entry["data_offsets"]]
    }


def _channels_first(images: Tensor) -> Tensor:
    return images.permute(0, 3, 1, 2).float() / 255
