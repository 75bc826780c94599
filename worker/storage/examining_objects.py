"""Examines the images of an S3-compatible store: every object is read."""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial

from schemas.errors import Damaged, RevisitError, SetupError
from worker.storage.examining_images import AGAIN, FOREIGN, LOST, NEW, ORPHAN, THEIRS, Needed, is_foreign, still_needed
from worker.storage.finding import REPAIR, Finding
from worker.storage.image_files import DIGEST, LOCK
from worker.storage.image_objects import AT_ONCE, PROBE, ImageObjects
from worker.storage.owner_file import OWNER
from worker.storage.peers import ImageHold
from worker.storage.signs import ALIVE, Sign, read
from worker.storage.snapshot_places import SNAPSHOTS
from worker.storage.uploads import IMPORTS

COPY = "was ahead of this database a moment ago: another copy of it is served with these images"
COPIES = "see REVISIT_DATABASE and REVISIT_IMAGES; if this one was restored just now, look again in two minutes"

_BESIDE = re.compile(rf"{re.escape(PROBE)}|{OWNER}|{ALIVE}|({IMPORTS}|{SNAPSHOTS})/.*|[0-9a-f]{{2}}/{re.escape(LOCK)}")
"""Objects that are no images; locks came with the images, from a folder."""


def object_findings(
    address: str,
    owners: dict[str, str] | None,
    own: str | None,
    *,
    running: bool = False,
    elsewhere: bool = False,
    new: bool = False,
    needed: Needed | None = None,
) -> Iterator[Finding]:
    """Findings of all images of a store.

    Parameters
    ----------
    address : str
        ``s3://bucket/prefix``.
    owners : mapping or None
        SHA-256 of each image to the view that needs it, as text; None when the database could not be read.
    own : str or None
        Id of the database.
    running : bool
        Whether a service of this folder runs: it may be writing or removing objects just now.
    elsewhere : bool
        Whether another copy of the database works on them.
    new : bool
    needed : function or None
        As in `image_findings`.
    """
    try:
        objects = ImageObjects(address, owned=set, locked=lambda _: nullcontext(ImageHold()))
    except SetupError as error:
        yield Finding(address, "cannot be examined", str(error))
        return
    try:
        owner = objects.owner()
        lost = owner is None and new and not running and objects.holds_any()
        foreign = is_foreign(owner, own)
        if foreign:
            yield Finding(objects.owner_name, FOREIGN, THEIRS)
        elif lost:
            yield Finding(address, NEW, LOST)
        elif elsewhere:
            yield Finding(f"{objects.address}/{ALIVE}", COPY, COPIES)
        yield from _findings(objects, address, owners, running or foreign or lost or elsewhere, needed)
    except RevisitError as error:
        yield Finding(address, "cannot be examined", error.detail)
    finally:
        objects.close()


def last_sign(address: str) -> Sign | None:
    """The last sign of life beside images; None where there is none, or it cannot be read now."""
    try:
        objects = ImageObjects(address, owned=set, locked=lambda _: nullcontext(ImageHold()))
    except SetupError:
        return None
    try:
        return read(objects.prompt)
    except RevisitError:
        return None
    finally:
        objects.close()


def _findings(
    objects: ImageObjects, address: str, owners: dict[str, str] | None, running: bool, needed: Needed | None
) -> Iterator[Finding]:
    missing = dict(owners or {})
    bad: dict[str, Finding] = {}
    placed: list[str] = []
    for name in objects.names():
        digest = name.rpartition("/")[2]
        if DIGEST.fullmatch(digest) and name == f"{digest[:2]}/{digest[2:4]}/{digest}":
            placed.append(digest)
        elif not _BESIDE.fullmatch(name):
            yield Finding(f"{address}/{name}", "is not of revisit", "move it away")
    with ThreadPoolExecutor(AT_ONCE, "revisit-images") as pool:
        faults = pool.map(partial(_fault, objects), placed)
        for digest, fault in zip(placed, faults, strict=True):
            where = f"{address}/{digest[:2]}/{digest[2:4]}/{digest}"
            view = missing.pop(digest, None)
            if fault is not None:
                of = view or "no view"
                bad[digest] = Finding(where, f"{fault}; it is the image of {of}", f"cannot be mended: {AGAIN}")
            elif owners is not None and view is None and not running:
                yield Finding(where, ORPHAN, f"{REPAIR} removes it")
    for digest, view in missing.items():
        what = f"is missing; it is the image of {view}"
        bad[digest] = Finding(f"{address}/{digest}", what, f"cannot be mended: {AGAIN}")
    yield from still_needed(bad, needed)


def _fault(objects: ImageObjects, digest: str) -> str | None:
    """What is wrong with an image, in words."""
    try:
        objects.read(digest)
    except Damaged:
        return "is missing or does not hold what was enrolled"
    return None
