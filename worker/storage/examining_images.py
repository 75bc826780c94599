"""Examines the folder of images: deleted, damaged, emptied, orphaned and foreign files."""

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from worker.storage.finding import REPAIR, Finding
from worker.storage.image_files import DIGEST, LOCK, UNFINISHED, owner_of
from worker.storage.owner_file import OWNER
from worker.storage.signs import ALIVE

AGAIN = "enrol the image again, or restore the file from a backup"
ORPHAN = "belongs to no view"
LEFTOVER = "was left unfinished by a crash"
FOREIGN = "says that the images are of another database"
THEIRS = "see REVISIT_DATABASE; if that one is gone, remove this: the next start removes images that no view here needs"
NEW = "holds images already, and nothing was ever enrolled into the database"
LOST = "see REVISIT_DATABASE; if the file of the database was lost, restore a backup of it"

Needed = Callable[[list[str]], set[str]]


def is_foreign(owner: str | None, own: str | None) -> bool:
    """Whether images are of another database than that with the id `own`; where either is unknown, they are not."""
    return owner is not None and own is not None and owner != own


def image_findings(
    folder: Path,
    owners: dict[str, str] | None,
    own: str | None,
    *,
    running: bool = False,
    new: bool = False,
    needed: Needed | None = None,
) -> Iterator[Finding]:
    """Findings of all files of images.

    Parameters
    ----------
    folder : Path
    owners : mapping or None
        SHA-256 of each image to the view that needs it, as text; None when the database could not be read.
    own : str or None
        Id of the database.
    running : bool
        Whether a service uses the folder: it may be writing or removing files just now.
    new : bool
        Whether nothing was ever enrolled into the database, so that images which nobody has taken are not its.
    needed : function or None
        Which of these digests views need by now; None: those of `owners`.
    """
    if not os.access(folder, os.R_OK | os.X_OK):
        if folder.exists() or owners:
            yield Finding(str(folder), "is missing or cannot be read", "see its permissions, or restore a backup")
        return
    missing = dict(owners or {})
    bad: dict[str, Finding] = {}
    try:
        owner = owner_of(folder)
        foreign = is_foreign(owner, own)
    except OSError as error:
        yield Finding(str(folder / OWNER), f"cannot be read ({error.strerror})", "see its permissions")
        foreign = True
    else:
        if foreign:
            yield Finding(str(folder / OWNER), FOREIGN, THEIRS)
        elif owner is None and new and not running and any(DIGEST.fullmatch(one.name) for one in files_below(folder)):
            yield Finding(str(folder), NEW, LOST)
            foreign = True
    for path in files_below(folder):
        name = str(path.relative_to(folder.parent))
        digest = path.name
        placed = path.parent == folder / digest[:2] / digest[2:4]
        if path in (folder / OWNER, folder / ALIVE) or (path.name == LOCK and path.parent.parent == folder):
            continue  # the sign of life came with the images, from an object store
        if path.name.startswith(UNFINISHED):
            if not running:
                yield Finding(name, LEFTOVER, f"{REPAIR} removes it")
        elif not DIGEST.fullmatch(digest) or not placed:
            yield Finding(name, "is not of revisit", "move it away")
        else:
            view = missing.pop(digest, None)
            if (fault := _fault(path)) is not None:
                of = view or "no view"
                bad[digest] = Finding(name, f"{fault}; it is the image of {of}", f"cannot be mended: {AGAIN}")
            elif owners is not None and view is None and not running and not foreign:
                yield Finding(name, ORPHAN, f"{REPAIR} removes it")
    for digest, view in missing.items():
        shown = f"pictures/{digest[:2]}/{digest[2:4]}/{digest}" if DIGEST.fullmatch(digest) else repr(digest)
        bad[digest] = Finding(shown, f"is missing; it is the image of {view}", f"cannot be mended: {AGAIN}")
    yield from still_needed(bad, needed)


def still_needed(bad: Mapping[str, Finding], needed: Needed | None) -> Iterator[Finding]:
    """Findings of images, by their digests, but for those that no view needs any longer."""
    wanted = bad.keys() if needed is None else needed(list(bad))
    return (finding for digest, finding in bad.items() if digest in wanted)


def files_below(folder: Path) -> Iterator[Path]:
    """All files below a folder, in order; what cannot be read is left out here and missed elsewhere."""
    for root, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            yield Path(root) / name


def _fault(path: Path) -> str | None:
    try:
        sums = hashlib.sha256()
        with path.open("rb") as file:
            while portion := file.read(1 << 20):
                sums.update(portion)
        if sums.hexdigest() == path.name:
            return None
        return "does not hold what was enrolled" if path.stat().st_size else "is empty"
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def is_orphan(finding: Finding) -> bool:
    """Whether a finding is of a file that repair removes."""
    return finding.what in (ORPHAN, LEFTOVER) and re.match("pictures/|s3://", finding.where) is not None
