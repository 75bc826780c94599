"""The shipped network as graphs for ONNX Runtime, which needs two thirds of torch's time on one thread.

The graphs take ``images``, uint8 of shape (n, height, width, 3), RGB, height and width multiples of 32 (padding is
fixed when a graph is traced), and give unit-length embeddings, float32 of shape (n, rows, columns, channels):

``compact.onnx``
    ``words`` and ``detail``, as `CompactNetwork.forward` has them.
``compact-fine.onnx``
    ``segmentation``, as `SegmentationNetwork` has them.
``compact-second.onnx``
    ``segmentation``, as `IndependentSegmentationNetwork` has them.

One graph with all outputs would be slower: ONNX Runtime computes them all, whichever are asked for.

No graph holds weights. They are external data in ``compact.safetensors`` and the files named like it, at the
places that their headers give, float16 as they are there, and widened when a session loads. So they ship once, and
cannot differ from torch's.

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
from safetensors.torch import load_file
from torch import Tensor, nn

from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

_OPSET = 17


class Fields(nn.Module):
    """Both fields at stride 8, from and to the layout that the encoder has."""

    def __init__(self, network: CompactNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Map uint8 (n, height, width, 3) to float (n, height / 8, width / 8, channels), twice."""
        words, detail = self.network(_channels_first(images))
        return words.permute(0, 2, 3, 1), detail.permute(0, 2, 3, 1)


class SecondGraph(nn.Module):
    """The second segmentation network, from and to the layout that the encoder has."""

    def __init__(self, second: IndependentSegmentationNetwork) -> None:
        super().__init__()
        self.second = second

    def forward(self, images: Tensor) -> Tensor:
        """Map uint8 (n, height, width, 3) to float (n, height / 4, width / 4, channels)."""
        words: Tensor = self.second(_channels_first(images))
        return words.permute(0, 2, 3, 1)


class SegmentationGraph(nn.Module):
    """The segmentation network, from and to the layout that the encoder has."""

    def __init__(self, network: CompactNetwork, fine: SegmentationNetwork) -> None:
        super().__init__()
        self.network, self.fine = network, fine

    def forward(self, images: Tensor) -> Tensor:
        """Map uint8 (n, height, width, 3) to float (n, height / 4, width / 4, channels)."""
        words: Tensor = self.fine(*self.network.levels(_channels_first(images)))
        return words.permute(0, 2, 3, 1)


def write_fields_graph(weights: Path) -> Path:
    """Write the graph of both fields beside the exported weights that it refers to."""
    target = weights.with_suffix(".onnx")
    _write_graph(Fields(shipped_network(weights)), ("words", "detail"), {"network.": weights}, target)
    return target


def write_segmentation_graph(weights: Path, fine: Path) -> Path:
    """Write the graph of the segmentation network beside both files of exported weights that it refers to."""
    target = fine.with_suffix(".onnx")
    module = SegmentationGraph(shipped_network(weights), SegmentationNetwork.loaded(load_file(fine)))
    _write_graph(module, ("fine_words",), {"network.": weights, "fine.": fine}, target)
    return target


def write_second_graph(second: Path) -> Path:
    """Write the graph of the second segmentation network beside the exported weights that it refers to."""
    target = second.with_suffix(".onnx")
    module = SecondGraph(IndependentSegmentationNetwork.loaded(load_file(second)))
    _write_graph(module, ("fine_words",), {"second.": second}, target)
    return target


def shipped_network(weights: Path) -> CompactNetwork:
    """Load an exported network."""
    return CompactNetwork.loaded({name: t for name, t in load_file(weights).items() if not name.startswith("text.")})


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
    """Replace parameters, whose names begin as `weights` says, by references into its files, each widened by a cast."""
    stored = {begin + name: (file, place) for begin, file in weights.items() for name, place in _places(file).items()}
    inline, casts = [], []
    for tensor in model.graph.initializer:
        if tensor.name not in stored:
            inline.append(tensor)
            continue
        file, place = stored[tensor.name]
        if tuple(tensor.dims) != place.shape or place.kind != "F16":
            raise ValueError(f"{tensor.name} is {tuple(tensor.dims)}, but {file.name} holds {place}")
        outside = onnx.TensorProto(name=f"{tensor.name}.half", dims=tensor.dims, data_type=onnx.TensorProto.FLOAT16)
        outside.data_location = onnx.TensorProto.EXTERNAL
        for key, value in (("location", file.name), ("offset", place.offset), ("length", place.length)):
            outside.external_data.add(key=key, value=str(value))
        inline.append(outside)
        casts.append(onnx.helper.make_node("Cast", [outside.name], [tensor.name], to=onnx.TensorProto.FLOAT))
    nodes = casts + list(model.graph.node)
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.extend(inline)
    model.graph.node.extend(nodes)


class _Place(NamedTuple):
    """Where a safetensors file holds a tensor: bytes from its beginning, and what they mean."""

    offset: int
    length: int
    shape: tuple[int, ...]
    kind: str


def _places(weights: Path) -> dict[str, _Place]:
    """Read the header of a safetensors file: its length in eight bytes, then JSON; the tensors follow."""
    with weights.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
    header.pop("__metadata__", None)
    return {
        name: _Place(8 + length + begin, end - begin, tuple(entry["shape"]), entry["dtype"])
        for name, entry in header.items()
        for begin, end in [entry["data_offsets"]]
    }


def _channels_first(images: Tensor) -> Tensor:
    return images.permute(0, 3, 1, 2).float() / 255
