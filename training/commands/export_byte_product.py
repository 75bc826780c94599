"""The inner product of int8 vectors as a graph for ONNX Runtime, which has it for every processor.

Left vectors come as uint8, 128 more than they are: the product of unsigned with signed bytes is the one that processors
have instructions for.

``python -m training.commands.export_byte_product`` writes it where the service reads it.

Needs the package ``onnx``, which the service does not.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from onnx import TensorProto, helper, save_model

from worker.search.byte_product import GRAPH

_OPSET, _FORMAT = 13, 8
"""Of operators, and of files: old ones, which every ONNX Runtime reads."""


def write_byte_product(path: Path) -> None:
    """Write the graph: ``left`` uint8 (n, d), ``right`` int8 (m, d), ``products`` int32 (n, m)."""
    nodes = [
        helper.make_node("Transpose", ["right"], ["columns"], perm=[1, 0]),
        helper.make_node("MatMulInteger", ["left", "columns", "zero"], ["products"]),
    ]
    graph = helper.make_graph(
        nodes,
        "byte_product",
        [
            helper.make_tensor_value_info("left", TensorProto.UINT8, ["n", "d"]),
            helper.make_tensor_value_info("right", TensorProto.INT8, ["m", "d"]),
        ],
        [helper.make_tensor_value_info("products", TensorProto.INT32, ["n", "m"])],
        [helper.make_tensor("zero", TensorProto.UINT8, [], [128])],
    )
    save_model(helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_FORMAT), path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.export_byte_product", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--to", type=Path, default=GRAPH)
    write_byte_product(parser.parse_args(arguments).to)


if __name__ == "__main__":
    main()
