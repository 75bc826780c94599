"""Weights files: what they are."""

import json
from pathlib import Path

import safetensors

from worker.encoders.compact.encoder import WEIGHTS
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
        return _check_compact(path, len(names))
    return checkpoint.check(path)


def _check_compact(path: Path, count: int) -> WeightsReport:
    """Whether a file is whole, and is one of those that ship or what the JSON file beside it describes."""
    sha256 = checkpoint.file_digest(path)
    known = {}
    for described in (*sorted(WEIGHTS.parent.glob("*.json")), path.with_suffix(".json")):
        if digest := _described(described):
            known[digest] = described.stem
    differences = []
    try:
        with safetensors.safe_open(path, framework="np"):
            pass
    except safetensors.SafetensorError as error:
        differences.append(f"not a whole safetensors file: {error}")
    if sha256 not in known:
        differences.append(
            "its SHA-256 is of none of the weights that ship, and not the one of a file "
            f"{path.with_suffix('.json').name} beside it, as `python -m training.commands.export` writes both"
        )
    note = f"{count} tensors: the weights of revisit's own encoder, {known.get(sha256, 'changed')}"
    digest = None if differences else sha256
    return WeightsReport(path, "compact", path.stat().st_size, sha256, digest, tuple(differences), (note,))


def _described(path: Path) -> str | None:
    """SHA-256 of the weights that a JSON file describes; None where it describes none."""
    try:
        return str(json.loads(path.read_text())["weights"]["sha256"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


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
