"""Examines the images of an S3-compatible store: every object is read."""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial

from schemas.errors import Damaged, RevisitError, SetupError
from worker.storage.finding import Finding
from worker.storage.image_files import DIGEST, LOCK
from worker.storage.image_objects import AT_ONCE, PROBE, ImageObjects
from worker.storage.known_images import ImageFindings, KnownImages
from worker.storage.owner_file import OWNER
from worker.storage.peers import ImageHold
from worker.storage.signs import ALIVE, Sign, read
from worker.storage.snapshot_places import SNAPSHOTS
from worker.storage.uploads import IMPORTS

COPY = "was ahead of this database a moment ago: another copy of it is served with these images"
COPIES = "see REVISIT_DATABASE and REVISIT_IMAGES; if this one was restored just now, look again in two minutes"

_BESIDE = re.compile(rf"{re.escape(PROBE)}|{OWNER}|{ALIVE}|({IMPORTS}|{SNAPSHOTS})/.*|[0-9a-f]{{2}}/{re.escape(LOCK)}")
"""Objects that are no images; locks came with the images, from a folder."""


def object_findings(address: str, known: KnownImages) -> Iterator[Finding]:
    """Findings of all images of the store at an address such as ``s3://bucket/prefix``."""
    try:
        objects = ImageObjects(address, owned=set, locked=lambda _: nullcontext(ImageHold()))
    except SetupError as error:
        yield Finding(address, "cannot be examined", str(error))
        return
    try:
        theirs = known.owner_finding(objects.owner(), objects.owner_name, address, objects.holds_any)
        if theirs is None and known.elsewhere:
            theirs = Finding(f"{objects.address}/{ALIVE}", COPY, COPIES)
        if theirs is not None:
            yield theirs
        findings = ImageFindings(known, keeps_orphans=known.running or theirs is not None)
        yield from _findings(objects, address, findings)
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


def _findings(objects: ImageObjects, address: str, findings: ImageFindings) -> Iterator[Finding]:
    placed: list[str] = []
    for name in objects.names():
        digest = name.rpartition("/")[2]
        if DIGEST.fullmatch(digest) and name == f"{digest[:2]}/{digest[2:4]}/{digest}":
            placed.append(digest)
        elif not _BESIDE.fullmatch(name):
            yield Finding(f"{address}/{name}", "is not of revisit", "move it away")
    with ThreadPoolExecutor(AT_ONCE, "revisit-images") as pool:
        for digest, fault in zip(placed, pool.map(partial(_fault, objects), placed), strict=True):
            yield from findings.of(digest, f"{address}/{digest[:2]}/{digest[2:4]}/{digest}", fault)
    yield from findings.rest(lambda digest: f"{address}/{digest}")


def _fault(objects: ImageObjects, digest: str) -> str | None:
    """What is wrong with an image, in words."""
    try:
        objects.read(digest)
    except Damaged:
        return "is missing or does not hold what was enrolled"
    return None
