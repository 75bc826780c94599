"""Examines the folder of images: deleted, damaged, emptied, orphaned and foreign files."""

import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from worker.storage.finding import REPAIR, Finding
from worker.storage.image_files import DIGEST, LOCK, UNFINISHED, owner_of
from worker.storage.known_images import ORPHAN, ImageFindings, KnownImages
from worker.storage.owner_file import OWNER
from worker.storage.signs import ALIVE

LEFTOVER = "was left unfinished by a crash"


def image_findings(folder: Path, known: KnownImages) -> Iterator[Finding]:
    """Findings of all files of images."""
    if not os.access(folder, os.R_OK | os.X_OK):
        if folder.exists() or known.owners:
            yield Finding(str(folder), "is missing or cannot be read", "see its permissions, or restore a backup")
        return
    theirs = _owner_finding(folder, known)
    if theirs is not None:
        yield theirs
    findings = ImageFindings(known, keeps_orphans=known.running or theirs is not None)
    for path in files_below(folder):
        name = str(path.relative_to(folder.parent))
        if path in (folder / OWNER, folder / ALIVE) or (path.name == LOCK and path.parent.parent == folder):
            continue  # the sign of life came with the images, from an object store
        if path.name.startswith(UNFINISHED):
            if not known.running:
                yield Finding(name, LEFTOVER, f"{REPAIR} removes it")
        elif DIGEST.fullmatch(path.name) and name == _place(path.name):
            yield from findings.of(path.name, name, _fault(path))
        else:
            yield Finding(name, "is not of revisit", "move it away")
    yield from findings.rest(lambda digest: _place(digest) if DIGEST.fullmatch(digest) else repr(digest))


def _owner_finding(folder: Path, known: KnownImages) -> Finding | None:
    """What says that the images are not of this database, or hides whose they are."""
    try:
        owner = owner_of(folder)
    except OSError as error:
        return Finding(str(folder / OWNER), f"cannot be read ({error.strerror})", "see its permissions")
    return known.owner_finding(
        owner, str(folder / OWNER), str(folder), lambda: any(DIGEST.fullmatch(one.name) for one in files_below(folder))
    )


def _place(digest: str) -> str:
    return f"pictures/{digest[:2]}/{digest[2:4]}/{digest}"


def files_below(folder: Path) -> Iterator[Path]:
    """All files below a folder, in order; what cannot be read is left out here and missed elsewhere."""
    for root, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            yield Path(root) / name


def _fault(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() == path.name:
                return None
        return "does not hold what was enrolled" if path.stat().st_size else "is empty"
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def is_orphan(finding: Finding) -> bool:
    """Whether a finding is of a file that repair removes."""
    return finding.what in (ORPHAN, LEFTOVER) and re.match("pictures/|s3://", finding.where) is not None
