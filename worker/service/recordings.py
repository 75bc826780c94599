"""Recordings: the images of an upload with what is known of them, in the order in which they are enrolled."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from schemas.errors import BadBody
from schemas.records import ViewAttributes
from schemas.settings import MEGA, Settings
from schemas.values import composed, file_name
from worker.images import codec
from worker.service import trajectories
from worker.service.archives import MOST_MANIFEST_BYTES, Archive, Entry
from worker.service.manifests import Manifest, attributes, read_manifest
from worker.service.trajectories import Pose

_LISTS = (".csv", ".tsv", ".json", ".jsonl", ".ndjson", ".xlsx", ".xls")
"""Endings of files that may be meant as manifests."""


@dataclass(frozen=True)
class Note:
    """Something of a recording that was not imported, or not as its owner may have meant.

    Parameters
    ----------
    file : str
    problem : str
        A code: of a problem type, or ``no-row``, ``no-file``, ``no-image``, ``bad-row``.
    detail : str
        What was wrong, and with what.
    """

    file: str
    problem: str
    detail: str


@dataclass(frozen=True)
class Item:
    """An image of a recording.

    Parameters
    ----------
    file : str
        Path within the recording.
    attributes : ViewAttributes
    read : function
        Returns its bytes; raises ValueError, RevisitError, Repeated.
    original : function or None
        Bytes of the image that it is made of, whose EXIF counts; None: it is made of none.
    turn : float
        Degrees by which it is turned clockwise against that one.
    """

    file: str
    attributes: ViewAttributes
    read: Callable[[], bytes]
    original: Callable[[], bytes] | None = None
    turn: float = 0.0


@dataclass(frozen=True)
class Limits:
    """Bounds of recordings.

    Parameters
    ----------
    image : codec.Limits
        Of one image.
    unpacked_bytes : int
        Of all files.
    frame_s : float
        Seconds for decoding one frame of a video.
    """

    image: codec.Limits
    unpacked_bytes: int
    frame_s: float

    @classmethod
    def of(cls, settings: Settings) -> "Limits":
        """Those that the settings ask for."""
        return cls(codec.Limits.of(settings), round(2 * settings.max_import_mb * MEGA), settings.decode_s)


@dataclass
class Recording:
    """An opened recording; a `with` statement closes it.

    Parameters
    ----------
    items : list of Item
    notes : list of Note
        What is known to be wrong before anything is enrolled.
    failed : int
        Images among the notes, which are not in `items`.
    left_out : int
        Images that are not wanted, and not in `items`.
    """

    close: Callable[[], None]
    items: list[Item] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    failed: int = 0
    left_out: int = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_archive(path: Path, limits: Limits) -> Recording:
    """Open a zip archive of images, with or without a manifest.

    Raises
    ------
    BadBody, BodyTooLarge
        Nothing of it can be imported.
    """
    archive = Archive(path, limits.unpacked_bytes)
    recording = Recording(archive.close)
    try:
        manifest = _manifest(archive)
        used, walked, depths = (set[str](), None, set[str]()) if manifest is not None else _trajectory(archive)
        for entry in archive.images:
            if entry.name in depths:
                recording.left_out += 1
            elif walked is not None:
                _add_walked(recording, archive, entry, walked, limits)
            else:
                _add(recording, archive, entry, manifest, limits)
        if manifest is not None and manifest.rows and len(manifest.unused()) == len(manifest.rows):
            row, image = manifest.rows[0], archive.images[0].name
            names = f"no row names the end of an image's path: line {row.line} has {row.file!r}, an image is {image!r}"
            raise BadBody("malformed-body", f"the manifest cannot be used: {manifest.name}: {names}")
    except BaseException:
        archive.close()
        raise
    for entry in archive.others:
        if entry.name in used:
            continue
        hint = "; a manifest is named manifest.csv or manifest.ndjson" if entry.name.lower().endswith(_LISTS) else ""
        recording.notes.append(Note(entry.name, "no-image", f"is no image by its name, and was left out{hint}"))
    if manifest is not None:
        for row in manifest.unused():
            detail = f"{manifest.name}, line {row.line}: no image of the recording has this name"
            recording.notes.append(Note(row.file, "no-file", detail))
    return recording


def _manifest(archive: Archive) -> Manifest | None:
    if archive.manifest is None:
        return None
    try:
        return read_manifest(archive.manifest.name, archive.read(archive.manifest, MOST_MANIFEST_BYTES))
    except ValueError as error:
        raise BadBody("malformed-body", f"the manifest cannot be used: {error}") from None


def _trajectory(archive: Archive) -> tuple[set[str], dict[str, Pose] | None, set[str]]:
    """Files that were read for poses, and poses by image, None where there is no trajectory; and depth images.

    Raises
    ------
    BadBody
        There are several, or one that cannot be used.
    """
    named = [entry for entry in archive.others if trajectories.is_trajectory(entry.name)]
    if not named:
        return set(), None, set()
    if len(named) > 1:
        several = f"it has {len(named)} trajectories, such as {named[0].name} and {named[1].name}"
        raise BadBody("malformed-body", f"the archive is refused: {several}; keep one, or send a manifest")
    lists = [entry for entry in archive.others if trajectories.is_list(entry.name)]
    others = [entry for entry in archive.others if trajectories.is_list_of_depths(entry.name)]
    try:
        poses = trajectories.read_poses(named[0].name, archive.read(named[0], MOST_MANIFEST_BYTES))
        times, deep = _listed(archive, lists), _listed(archive, others)
        names = {entry.name: entry.name.replace("\\", "/") for entry in archive.images}
        depths = {entry for entry, file in names.items() if trajectories.is_depth(file, deep, times)}
        files = [file for entry, file in names.items() if entry not in depths]
        used = {entry.name for entry in (*named, *lists, *others)}
        return used, trajectories.poses_of(files, poses, times), depths
    except ValueError as error:
        raise BadBody("malformed-body", f"the trajectory cannot be used: {error}") from None


def _listed(archive: Archive, lists: Sequence[Entry]) -> dict[str, float]:
    """Times by the ends of files' paths; raises ValueError.

    A list is about the files beside it, and about others where no list says otherwise.
    """
    of_folder: dict[str, float] = {}
    others: dict[str, set[float]] = {}
    for entry in lists:
        folder = composed(entry.name.replace("\\", "/")).rpartition("/")[0]
        for file, time in trajectories.read_list(entry.name, archive.read(entry, MOST_MANIFEST_BYTES)).items():
            of_folder[f"{folder}/{file}" if folder else file] = time
            others.setdefault(file, set()).add(time)
    return {file: times.pop() for file, times in others.items() if len(times) == 1} | of_folder


def _add_walked(
    recording: Recording, archive: Archive, entry: Entry, walked: Mapping[str, Pose], limits: Limits
) -> None:
    pose = walked.get(entry.name.replace("\\", "/"))
    if pose is None:
        detail = f"no pose lies within {trajectories.TOLERANCE_S:g} s of it; it is enrolled without position"
        recording.notes.append(Note(entry.name, "no-row", detail))
    known = ViewAttributes() if pose is None else pose.attributes()
    _keep(recording, archive, entry, known, limits)


def _keep(recording: Recording, archive: Archive, entry: Entry, known: ViewAttributes, limits: Limits) -> None:
    known = replace(known, filename=file_name(entry.name))
    recording.items.append(Item(entry.name, known, lambda: archive.read(entry, limits.image.max_bytes)))


def _add(recording: Recording, archive: Archive, entry: Entry, manifest: Manifest | None, limits: Limits) -> None:
    known = ViewAttributes()
    if manifest is not None:
        row = manifest.of(entry.name.replace("\\", "/"))
        if row is None:
            detail = f"{manifest.name} has no row for it; it is enrolled without position"
            recording.notes.append(Note(entry.name, "no-row", detail))
        else:
            try:
                known = attributes(row, manifest.name)
            except ValueError as error:  # an image in the wrong place would be worse than none
                recording.notes.append(Note(entry.name, "bad-row", str(error)))
                recording.failed += 1
                return
    _keep(recording, archive, entry, known, limits)
