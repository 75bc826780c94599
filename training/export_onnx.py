"""The shipped network as graphs for ONNX Runtime, which needs two thirds of torch's time on one thread.

Both graphs take ``pictures``, uint8 of shape (n, height, width, 3), RGB, height and width multiples of 32 (padding is
fixed when a graph is traced), and give unit-length embeddings, float32 of shape (n, rows, columns, channels):

``compact.onnx``
    ``words`` and ``detail``, as `CompactNetwork.forward` has them.
``compact-fine.onnx``
    ``fine_words``, as `CompactNetwork.fine_words` has them.

One graph with three outputs would be slower: ONNX Runtime computes them all, whichever are asked for.

Neither graph holds weights. They are external data in ``compact.safetensors``, at the places that its header gives,
float16 as they are there, and widened when a session loads. So they ship once, and cannot differ from torch's.

Needs the package ``onnx``, which the service does not.
"""

import importlib
import json
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from worker.encoders.compact_network import CompactNetwork

_OPSET = 17


class Fields(nn.Module):
    """Both fields at stride 8, from and to the layout that the encoder has."""

    def __init__(self, network: CompactNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Map uint8 (n, height, width, 3) to float (n, height / 8, width / 8, channels), twice."""
        words, detail = self.network(_channels_first(pictures))
        return words.permute(0, 2, 3, 1), detail.permute(0, 2, 3, 1)


class FineWords(nn.Module):
    """The words field at stride 4, from and to the layout that the encoder has."""

    def __init__(self, network: CompactNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, pictures: Tensor) -> Tensor:
        """Map uint8 (n, height, width, 3) to float (n, height / 4, width / 4, channels)."""
        return self.network.fine_words(_channels_first(pictures)).permute(0, 2, 3, 1)


def write_graphs(weights: Path) -> dict[str, Path]:
    """Write both graphs beside the weights that they refer to.

    Parameters
    ----------
    weights : Path
        Of an exported safetensors file.

    Returns
    -------
    mapping of ``fields`` and ``fine`` to Path
    """
    state = {name: tensor for name, tensor in load_file(weights).items() if not name.startswith("text.")}
    network = CompactNetwork.loaded(state)
    fields, fine = weights.with_suffix(".onnx"), weights.with_name(f"{weights.stem}-fine.onnx")
    _write_graph(Fields(network), ("words", "detail"), weights, fields)
    _write_graph(FineWords(network), ("fine_words",), weights, fine)
    return {"fields": fields, "fine": fine}


def _write_graph(module: nn.Module, outputs: Sequence[str], weights: Path, target: Path) -> None:
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


def _refer_to(weights: Path, model: Any, onnx: Any) -> None:
    """Replace the network's parameters by references into the weights file, each widened by a cast."""
    stored = _places(weights)
    inline, casts = [], []
    for tensor in model.graph.initializer:
        place = stored.get(tensor.name.removeprefix("network."))
        if place is None:
            inline.append(tensor)
            continue
        if tuple(tensor.dims) != place.shape or place.kind != "F16":
            raise ValueError(f"{tensor.name} is {tuple(tensor.dims)}, but {weights.name} holds {place}")
        outside = onnx.TensorProto(name=f"{tensor.name}.half", dims=tensor.dims, data_type=onnx.TensorProto.FLOAT16)
        outside.data_location = onnx.TensorProto.EXTERNAL
        for key, value in (("location", weights.name), ("offset", place.offset), ("length", place.length)):
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


def _channels_first(pictures: Tensor) -> Tensor:
    return pictures.permute(0, 3, 1, 2).float() / 255
