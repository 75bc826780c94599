"""LSeg's weights: reading, checking and converting ``demo_e200.ckpt``.

The published file is a PyTorch Lightning checkpoint: a pickled dict whose ``state_dict`` holds the tensors under names
that begin with ``net.``. Only tensors and plain values are ever unpickled. `convert` writes what the networks need as
safetensors, which is smaller, holds no pickle and keeps the digest.
"""

import argparse
import hashlib
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import safetensors
import torch
from safetensors.torch import save_file
from torch import Tensor

from schemas.errors import SetupError
from worker.encoders.lseg.config import PUBLISHED, Config
from worker.encoders.lseg.layout import SHOWN, Layout, differences
from worker.encoders.lseg.network import Network

PREFIX = "net."
FORMAT = "revisit-lseg-1"
"""Value of ``format`` in the metadata of a converted file."""

ZIP_MAGIC = b"PK\x03\x04"


@dataclass(frozen=True)
class WeightsReport:
    """What a weights file is.

    Parameters
    ----------
    path : Path
    kind : str
        ``lseg-checkpoint``, ``lseg-converted``, ``compact`` or ``unknown``.
    byte_count : int
    sha256 : str
        Of the file.
    digest : str or None
        Of the tensors that decide embeddings: what recipes carry. The same for a checkpoint and its conversion; None
        when the tensors are not those of the encoder.
    differences : tuple of str
        Every missing, surplus or wrongly shaped tensor, or why the file cannot be read. Empty: usable.
    notes : tuple of str
        What else was found in it.
    """

    path: Path
    kind: str
    byte_count: int
    sha256: str
    digest: str | None
    differences: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether an encoder can be made of it."""
        return self.kind != "unknown" and not self.differences


@dataclass(frozen=True)
class Contents:
    """A file's tensors, not yet read from the disk, and what is beside them."""

    kind: str
    tensors: Mapping[str, Tensor]
    notes: tuple[str, ...]


def read(path: Path) -> Contents:
    """Open a checkpoint or its conversion; the tensors stay on disk until they are used.

    Raises
    ------
    SetupError
        The file is not there, is cut short, or is something else.
    """
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise SetupError(f"weights {path}: {error.strerror}") from None
    if head.startswith(ZIP_MAGIC):
        return _read_checkpoint(path)
    if head[8:9] == b"{":
        return _read_converted(path)
    raise SetupError(
        f"weights {path}: expected LSeg's demo_e200.ckpt (a zip archive of PyTorch) or its conversion (safetensors), "
        f"saw a file of {path.stat().st_size} bytes that begins with {head[:8]!r}"
    )


def _read_checkpoint(path: Path) -> Contents:
    """A Lightning checkpoint."""
    try:
        # Lightning keeps the training's arguments in the file; a Namespace is inert, anything else stays refused.
        with torch.serialization.safe_globals([argparse.Namespace]):
            whole = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except pickle.UnpicklingError as error:
        raise SetupError(
            f"weights {path}: holds pickled objects other than tensors and plain values, which are never run: "
            f"{_first_line(error)}"
        ) from None
    except (RuntimeError, OSError, EOFError, ValueError, LookupError, AttributeError, TypeError) as error:
        # All of these come out of an archive or a pickle that is damaged.
        raise SetupError(
            f"weights {path}: not a whole PyTorch file ({path.stat().st_size} bytes): {_first_line(error)}"
        ) from None
    state = whole.get("state_dict") if isinstance(whole, dict) else None
    if not isinstance(state, dict):
        seen = sorted(map(str, whole))[:SHOWN] if isinstance(whole, dict) else type(whole).__name__
        raise SetupError(f"weights {path}: expected a checkpoint with a 'state_dict', saw {seen}")
    others = [str(name) for name, tensor in state.items() if not (isinstance(name, str) and isinstance(tensor, Tensor))]
    if others:
        raise SetupError(f"weights {path}: entries of 'state_dict' that are no tensors: {', '.join(others[:SHOWN])}")
    further = sorted(str(key) for key in whole if key != "state_dict")
    notes = (f"{len(state)} tensors; beside them: {', '.join(further) or 'nothing'}",)
    return Contents("lseg-checkpoint", {name.removeprefix(PREFIX): tensor for name, tensor in state.items()}, notes)


def _first_line(error: Exception) -> str:
    """The gist of an error of PyTorch's, which may go on for pages."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _read_converted(path: Path) -> Contents:
    """What `convert` wrote, or another safetensors file; names and shapes decide whether it is of use."""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    except (safetensors.SafetensorError, OSError) as error:
        raise SetupError(f"weights {path}: not a whole safetensors file: {error}") from None
    notes = (f"{len(tensors)} tensors", *(f"{key}: {value}" for key, value in sorted(metadata.items())))
    return Contents("lseg-converted", tensors, notes)


def digest(tensors: Mapping[str, Tensor], layout: Layout) -> str:
    """SHA-256 (hex) over names and float32 values of all tensors in use, by name.

    It is that of the values, not of a file: half-precision and float32 storage of the same numbers, and a checkpoint
    and its conversion, describe images alike, and so agree.
    """
    total = hashlib.sha256()
    for name in sorted(layout.used):
        total.update(name.encode())
        total.update(tensors[name].float().contiguous().numpy().data)
    return total.hexdigest()


def load(path: Path, config: Config = PUBLISHED) -> tuple[Network, str]:
    """The networks and the digest of their weights.

    Returns
    -------
    Network
        On the CPU, in float32. Float32 tensors lie in the file still: the pages that are used are read, and the
        system can drop and read them again when memory is short.
    str
        See `digest`.

    Raises
    ------
    SetupError
        The file cannot be read, or names, shapes or types of its tensors are not LSeg's.
    """
    contents = read(path)
    layout = Layout.of(config)
    found = differences(contents.tensors, layout)
    if found:
        more = f"; and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
        raise SetupError(
            f"weights {path} are not LSeg's: {'; '.join(found[:SHOWN])}{more} "
            f"(`./revisit weights check {path}` lists all)"
        )
    with torch.device("meta"):
        network = Network(config)
    network.load_state_dict({name: contents.tensors[name].float() for name in layout.used}, strict=True, assign=True)
    return network.eval().requires_grad_(False), digest(contents.tensors, layout)


def check(path: Path, config: Config = PUBLISHED) -> WeightsReport:
    """Say what a file is and how it departs from what LSeg needs; never raises for what is in the file.

    Raises
    ------
    SetupError
        There is no such file.
    """
    sha256 = file_digest(path)
    size = path.stat().st_size
    try:
        contents = read(path)
    except SetupError as error:
        return WeightsReport(path, "unknown", size, sha256, None, (error.detail,))
    layout = Layout.of(config)
    found = differences(contents.tensors, layout)
    kind = contents.kind if layout.used.keys() & contents.tensors.keys() else "unknown"
    made = None if found else digest(contents.tensors, layout)
    return WeightsReport(path, kind, size, sha256, made, found, contents.notes)


def convert(source: Path, target: Path, config: Config = PUBLISHED) -> WeightsReport:
    """Write what the networks need of a checkpoint as safetensors, each tensor in the type it has.

    Parameters
    ----------
    source : Path
        The checkpoint.
    target : Path
        The file to make; there must be none yet.

    Returns
    -------
    WeightsReport
        Of the new file, as `check` sees it.

    Raises
    ------
    SetupError
        The source is not LSeg's, or the target is there or cannot be written.
    """
    if target.exists():
        raise SetupError(f"{target} exists; remove it, or name another file")
    report = check(source, config)
    if report.digest is None:
        read(source)  # raises where it is no such file at all, and says so itself
        raise SetupError(f"weights {source} are not LSeg's: {'; '.join(report.differences[:SHOWN])}")
    contents = read(source)
    used = {name: contents.tensors[name].contiguous() for name in Layout.of(config).used}
    half_done = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        save_file(used, half_done, {"format": FORMAT, "source_sha256": report.sha256})
        half_done.rename(target)
    except (OSError, safetensors.SafetensorError) as error:
        raise SetupError(f"cannot write {target}: {error}") from None
    finally:
        half_done.unlink(missing_ok=True)
    return check(target, config)


def file_digest(path: Path) -> str:
    """SHA-256 (hex) of a file.

    Raises
    ------
    SetupError
        It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise SetupError(f"weights {path}: {error.strerror}") from None
