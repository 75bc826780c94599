"""What runs the compact network: ONNX Runtime on a CPU, torch on anything else, from files that are verified."""

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
        """Layers semantic and detail, float32 of shapes (n, height / 8, width / 8, channels), unit length."""
        ...

    def segment(self, images: Bytes2D, member: int) -> Floats:
        """Semantic layer of one member of the ensemble, float32 (n, height / 4, width / 4, channels), unit length."""
        ...


def on_cpu(facts: Mapping[str, Any], members: Sequence[Mapping[str, Any]], described: Path, threads: int) -> Engine:
    """The network in ONNX Runtime; raises SetupError."""
    from worker.encoders.compact.onnx import OnnxEngine

    if "graph" not in facts:
        raise SetupError(f"{described.name} names no graph for ONNX Runtime; fetch the repository's own file again")
    graphs = [facts["graph"], *(member["graph"] for member in members)]
    for graph in graphs:
        verified(described, graph)
    fields, *fine = (described.with_name(graph["file"]) for graph in graphs)
    return OnnxEngine(fields, fine, threads=threads)


def on_gpu(content: bytes, fine: Sequence[bytes], device: str) -> Engine:
    """The network in torch."""
    from worker.encoders.compact.torch import TorchEngine

    return TorchEngine(content, fine, device)


def verified(described: Path, named: Mapping[str, str]) -> bytes:
    """Read a file whose name and SHA-256 the JSON file `described` gives."""
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
