"""Recordings on their way to a service: archives read, and folders packed, piece by piece while they are sent."""

import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

from revisit_client.parameters import readable

SUFFIXES = frozenset((".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".heic", ".heif"))
"""Of images, which are sent of a folder."""

MANIFESTS = ("manifest.csv", "manifest.tsv", "manifest.ndjson", "manifest.jsonl")
"""Names of manifests."""

TRAJECTORIES = frozenset(
    [
        "groundtruth.txt",
        "trajectory.txt",
        "poses.txt",
        "pose.txt",
        "cameratrajectory.txt",
        "keyframetrajectory.txt",
        "rgb.txt",
        "images.txt",
        "depth.txt",
    ]
)
"""Names of files of poses, besides those that end with ``.tum``, and of lists of images, or depth, with their times."""

PIECE = 1 << 20
"""Bytes sent at a time."""


class Body:
    """The pieces of a body, from its beginning each time it is sent.

    Parameters
    ----------
    make : function
        Makes the pieces.
    """

    def __init__(self, make: Callable[[], Iterator[bytes]]) -> None:
        self._make = make

    def __iter__(self) -> Iterator[bytes]:
        return self._make()


class _Outgoing:
    """A file that is only written to; what was written is taken away."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []

    def write(self, data: bytes) -> int:
        self._pieces.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Nothing is held back."""

    def take(self) -> bytes:
        taken = b"".join(self._pieces)
        self._pieces.clear()
        return taken


def pieces_of(path: Path) -> Iterator[bytes]:
    """The bytes of a file, in pieces."""
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            yield piece


def files_of(folder: Path) -> list[Path]:
    """Images, manifests and poses of a folder, with all inside, sorted; nothing that is hidden, by a dot."""
    return sorted(
        path
        for path in folder.rglob("*")
        if (path.suffix.lower() in {*SUFFIXES, ".tum"} or path.name.lower() in {*MANIFESTS, *TRAJECTORIES})
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


def folder_as_zip(folder: Path, manifest: Path | None = None) -> Iterator[bytes]:
    """The images and manifests of a folder as a zip archive, in pieces; images are not packed any tighter.

    Parameters
    ----------
    folder : Path
    manifest : Path or None
        Added as the manifest.

    Raises
    ------
    ValueError
        There is a manifest in the folder too, or nothing to send.
    OSError
        The manifest cannot be read.
    """
    files = [(path, path.relative_to(folder).as_posix()) for path in files_of(folder)]
    if not any(path.suffix.lower() in SUFFIXES for path, _ in files):
        raise ValueError(f"{folder} holds no image ({', '.join(sorted(SUFFIXES))})")
    if manifest is not None:
        files = [(path, name) for path, name in files if path.resolve() != manifest.resolve()]
        there = [path for path, name in files if name.rpartition("/")[2].lower() in MANIFESTS]
        if there:
            raise ValueError(f"{there[0]} is a manifest, and {manifest} was given; one of them has to go")
        with manifest.open("rb"):  # it is the last to be packed: one that is missing is told first
            pass
        suffix = manifest.suffix.lower()
        name = f"manifest{suffix}" if f"manifest{suffix}" in MANIFESTS else "manifest.csv"
        files = [*files, (manifest, name)]
    return _zipped(files)


def _zipped(files: list[tuple[Path, str]]) -> Iterator[bytes]:
    out = _Outgoing()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:  # type: ignore[call-overload]
        for path, name in files:
            # Of the year 1980, like all: the archive of a folder is the same whenever it is made.
            with (
                path.open("rb") as source,
                archive.open(zipfile.ZipInfo(readable(name)), "w", force_zip64=True) as target,
            ):
                while piece := source.read(PIECE):
                    target.write(piece)
                    yield out.take()
    yield out.take()
