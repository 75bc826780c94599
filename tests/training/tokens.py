"""A drawn teacher, and what it cached of a data folder."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from lab.baselines.dinov2 import BLOCK, CHANNELS, SIZE
from training.commands import cache_tokens

PATCH = 14


def write_teacher(path: Path) -> Path:
    """Write a graph with DINOv2's shapes: channel 0 is a patch's mean red, the others mix its colours."""
    rng = np.random.default_rng(0)
    kernel = rng.standard_normal((CHANNELS, 3, 1, 1)).astype(np.float32) * np.ones((1, 1, PATCH, PATCH), np.float32)
    kernel[0] = 0
    kernel[0, 0] = 1
    kernel /= PATCH**2
    constants: list[Any] = [
        numpy_helper.from_array(kernel, "kernel"),
        numpy_helper.from_array(np.array([1, CHANNELS, -1]), "flat"),
        numpy_helper.from_array(np.zeros((1, 1, CHANNELS), np.float32), "class"),
    ]
    nodes = [
        helper.make_node("Conv", ["input", "kernel"], ["patches"], strides=[PATCH, PATCH]),
        helper.make_node("Reshape", ["patches", "flat"], ["rows"]),
        helper.make_node("Transpose", ["rows"], ["tokens"], perm=[0, 2, 1]),
        helper.make_node("Concat", ["class", "tokens"], [f"/blocks.{BLOCK}/Add_1_output_0"], axis=1),
    ]
    given = helper.make_tensor_value_info("input", onnx.TensorProto.FLOAT, [1, 3, SIZE, SIZE])
    out = helper.make_tensor_value_info(nodes[-1].output[0], onnx.TensorProto.FLOAT, [1, 257, CHANNELS])
    graph = helper.make_graph(nodes, "teacher", [given], [out], constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), str(path))
    return path


def cache(data: Path, folder: Path) -> Path:
    """Cache the drawn teacher's tokens of a data folder; returns the folder of the tokens."""
    teacher = write_teacher(folder / "teacher.onnx")
    cache_tokens.main(["--teacher", str(teacher), "--data", str(data), "--to", str(folder / "tokens")])
    return folder / "tokens"
