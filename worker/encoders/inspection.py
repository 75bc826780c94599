"""Weights files: their identification, and conversion of a published checkpoint to safetensors."""

import json
from pathlib import Path

from worker.encoders.lseg import checkpoint
from worker.encoders.lseg.checkpoint import WeightsReport

COMPACT_TENSORS = frozenset({"words.weight", "detail.weight"})
"""The two heads of the built-in encoder; no LSeg file has tensors of these names."""


def check(path: Path) -> WeightsReport:
    """Identify a file: LSeg's checkpoint, its conversion, revisit's own weights, or none of them.

    Raises
    ------
    SetupError
        There is no such file.
    """
    names = _safetensors_names(path)
    if names >= COMPACT_TENSORS:
        sha256 = checkpoint.file_digest(path)
        notes = (f"{len(names)} tensors: the weights of revisit's own encoder, compact",)
        return WeightsReport(path, "compact", path.stat().st_size, sha256, sha256, (), notes)
    return checkpoint.check(path)


def convert(source: Path, target: Path) -> WeightsReport:
    """Convert LSeg's checkpoint to a safetensors file; see `worker.encoders.lseg.checkpoint.convert`."""
    return checkpoint.convert(source, target)


def _safetensors_names(path: Path) -> frozenset[str]:
    """Names of the tensors in a safetensors file (header length in eight bytes, then JSON); empty for other files."""
    try:
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            if length > min(path.stat().st_size, 100_000_000):
                return frozenset()
            header = json.loads(file.read(length))
    except (OSError, ValueError):
        return frozenset()
    return frozenset(header) if isinstance(header, dict) else frozenset()
