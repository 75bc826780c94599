"""Engines that run the compact network from verified files: ONNX Runtime on a CPU, torch on any other device."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from schemas.description import Floats
from schemas.errors import SetupError
from schemas.image import Bytes2D


class Engine(Protocol):
    """Runs the network on images of one size: uint8 (n, height, width, 3), sides multiples of `input_size.MULTIPLE`."""

    def fields(self, images: Bytes2D) -> tuple[Floats, Floats]:
        """Layers semantic and detail, float32 of shape (n, height / 8, width / 8, channels) each, unit length."""
        ...

    def segment(self, images: Bytes2D, member: int) -> Floats:
        """Semantic layer of one ensemble member, float32 (n, height / 4, width / 4, channels), unit length."""
        ...


def on_cpu(
    facts: Mapping[str, Any], members: Sequence[Mapping[str, Any]], described: Path, threads: int, encodes: bool
) -> Engine:
    """Build the engine on ONNX Runtime; without `encodes` it only segments.

    Raises
    ------
    SetupError
        The JSON file names no graph, a graph is missing or changed, or ONNX Runtime cannot load it.
    """
    from worker.encoders.compact.onnx import OnnxEngine

    if "graph" not in facts:
        raise SetupError(f"{described.name} names no graph for ONNX Runtime; fetch the repository's own file again")
    graphs = [facts["graph"], *(member["graph"] for member in members)]
    for graph in graphs:
        verified(described, graph)
    fields, *fine = (described.with_name(graph["file"]) for graph in graphs)
    return OnnxEngine(fields if encodes else None, fine, threads=threads)


def on_gpu(content: bytes, fine: Sequence[bytes], device: str) -> Engine:
    """Build the engine on torch."""
    from worker.encoders.compact.torch import TorchEngine

    return TorchEngine(content, fine, device)


def verified(described: Path, named: Mapping[str, str]) -> bytes:
    """Content of a file beside the JSON file `described`, which gives its name and SHA-256.

    Raises
    ------
    SetupError
        The file is missing or has another SHA-256.
    """
    path, sha256 = described.with_name(named["file"]), named["sha256"]
    if not path.exists():
        raise SetupError(f"the encoder's file {path.name} is not in {path.parent}")
    content = path.read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise SetupError(
            f"{path.name} has the SHA-256 {found[:16]}..., but {described.name} describes {sha256[:16]}...; "
            "fetch the repository's own file again"
        )
    return content
