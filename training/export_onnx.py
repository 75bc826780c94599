"""The shipped network as an ONNX file: ``python -m training.export_onnx``, after ``python -m training.export``.

ONNX Runtime needs two thirds of torch's time on one thread. The file, ``compact.onnx`` beside the weights it is made
from, takes ``pictures`` (float32, n x 3 x height x width, RGB in 0..1, height and width multiples of 32: padding is
fixed when the graph is traced) and gives ``words`` and ``detail`` as ``CompactNetwork.forward`` does. Weights are kept
in float16, which they are exactly, and widened when a session loads.

Needs the package ``onnx``, which neither the service nor the training does.
"""

import argparse
import hashlib
import importlib
import json
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from training.export import network_of
from worker.encoders.compact_network import CompactNetwork

_OPSET = 17


def onnx_bytes(network: CompactNetwork) -> bytes:
    """Trace the network for pictures whose sides are multiples of 32 and serialise it, its weights in float16."""
    onnx: Any = importlib.import_module("onnx")
    sizes = {0: "n", 2: "height", 3: "width"}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the tracing exporter announces its successor
        traced = Path(folder) / "traced.onnx"
        torch.onnx.export(
            network,
            (torch.rand(1, 3, 96, 128),),
            traced,
            dynamo=False,
            opset_version=_OPSET,
            input_names=["pictures"],
            output_names=["words", "detail"],
            dynamic_axes={"pictures": sizes, "words": sizes, "detail": sizes},
        )
        model = onnx.load(str(traced))
    _halve_weights(model, onnx)
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def _halve_weights(model: Any, onnx: Any) -> None:
    """Store large float32 initialisers as float16, each followed by a cast that a session folds away."""
    casts = []
    for tensor in model.graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size > 1:
            name = tensor.name
            tensor.CopyFrom(onnx.numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
            casts.append(onnx.helper.make_node("Cast", [f"{name}.half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = list(model.graph.node)
    del model.graph.node[:]
    model.graph.node.extend(casts + nodes)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.export_onnx", description="Write compact.onnx.")
    parser.add_argument("--weights", type=Path, default=Path("worker/encoders/weights/compact.safetensors"))
    weights = parser.parse_args(arguments).weights
    content = onnx_bytes(network_of(weights))
    target = weights.with_suffix(".onnx")
    target.write_bytes(content)
    described = json.loads(weights.with_suffix(".json").read_text())
    described["onnx"] = {"file": target.name, "sha256": hashlib.sha256(content).hexdigest()}
    weights.with_suffix(".json").write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
