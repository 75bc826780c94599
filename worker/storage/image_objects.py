"""Enrolled images as objects of an S3-compatible store, named by the SHA-256 of their bytes.

The order is that of the folder (`image_files`): an object is there before the row that needs it is committed, and is
removed after the last such row. Names are the folder's too, ``prefix/ab/cd/abcd...``: one can be copied into the other.
An upload is whole or not there; the store compares it with its SHA-256, and it is compared again when it is read.
"""

import base64
import hashlib
import logging
import os
import re
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from itertools import groupby
from typing import Any

from schemas.errors import Damaged, RevisitError, SetupError
from schemas.settings import IMAGES_ADDRESS
from worker.storage import owner_file
from worker.storage.image_files import DIGEST, LOST, Discarded, Owned, damaged_or
from worker.storage.object_errors import MISSING, code_of, translated
from worker.storage.object_files import ObjectFiles
from worker.storage.owner_file import OWNER
from worker.storage.peers import ImageHold, ImageLock

log = logging.getLogger("revisit")

AT_ONCE = 16
"""Objects that are written or removed at a time."""

CONNECT_S, READ_S, ATTEMPTS = 3, 10, 3
"""Seconds for a connection and for an answer, and attempts with pauses between them: a call ends within some 40 s."""

PROBE_CONNECT_S, PROBE_READ_S = 1, 2
"""Of the one attempt that tells whether the store answers."""

PROBE = ".can-this-be-written"


def make_client(connect_s: float, read_s: float, attempts: int) -> Any:
    """A client of S3 by the usual variables: AWS_ENDPOINT_URL_S3, AWS_REGION, AWS_ACCESS_KEY_ID and the others.

    Raises
    ------
    SetupError
        boto3 is missing, or the variables cannot be used.
    """
    try:
        import boto3
        from botocore.config import Config
        from botocore.exceptions import BotoCoreError
    except ImportError as error:
        raise SetupError("REVISIT_IMAGES=s3://... needs the package boto3; install it with pip") from error
    elsewhere = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    config = Config(
        connect_timeout=connect_s,
        read_timeout=read_s,
        retries={"mode": "standard", "total_max_attempts": attempts},
        max_pool_connections=2 * AT_ONCE,
        # Stores other than Amazon's know the older checksums; ours is the SHA-256 that is sent and compared below.
        request_checksum_calculation="when_required",
        response_checksum_validation="when_required",
        s3={"addressing_style": "path"} if elsewhere else {},  # few of them have a host name for each bucket
    )
    try:
        return boto3.session.Session().client("s3", config=config)
    except (BotoCoreError, ValueError) as error:
        raise SetupError(f"the image store cannot be used: {error}; see the variables AWS_*") from error


class ImageObjects:
    """Images in a bucket.

    Parameters
    ----------
    address : str
        ``s3://bucket`` or ``s3://bucket/prefix``.
    owned : function
        Reads from the database which digests views still need.
    locked : function
        The locks of images.

    Raises
    ------
    SetupError
    """

    def __init__(self, address: str, owned: Owned, locked: ImageLock) -> None:
        parsed = re.fullmatch(IMAGES_ADDRESS, address)
        if parsed is None:
            raise SetupError(f"REVISIT_IMAGES={address!r} is no address such as s3://bucket/prefix")
        self.address = address.rstrip("/")
        self._bucket = parsed["bucket"]
        self._prefix = f"{parsed['prefix']}/" if parsed["prefix"] else ""
        self._owned, self._locked = owned, locked
        self._client = make_client(CONNECT_S, READ_S, ATTEMPTS)
        self._probing = make_client(PROBE_CONNECT_S, PROBE_READ_S, 1)
        self.files = ObjectFiles(self._client, self.address, self._bucket, self._prefix)
        self.prompt = ObjectFiles(self._probing, self.address, self._bucket, self._prefix)  # a start waits for it
        self._trouble = False  # whether the last image could not be written
        self._left: set[str] = set()  # images of deleted views that could not be removed yet
        self._closing = threading.Event()
        self._sweeper: threading.Thread | None = None

    @contextmanager
    def kept(self, digest: str, image: bytes) -> Iterator[ImageHold]:
        """Write an image durably, then run a block that commits a row with its digest, after `until_commit`.

        When the block raises, the object is removed unless a view needs it.

        Raises
        ------
        ValueError
            The digest is not that of the image.
        DiskFull, StorageFailed
        """
        if hashlib.sha256(image).hexdigest() != digest:
            raise ValueError(f"{digest} is not the SHA-256 of the image")
        with self._locked(digest[:2]) as hold:
            self._write(digest, image)
            try:
                yield hold
            except BaseException:
                self._left.add(digest)
                with suppress(RevisitError):  # then it goes later
                    self._remove([digest], hold)
                    self._left.discard(digest)
                raise

    def add(self, images: Mapping[str, bytes]) -> None:
        """Write images durably, by their digests, after `await_removals`; their rows are committed already.

        Raises
        ------
        DiskFull, StorageFailed
        """
        with ThreadPoolExecutor(AT_ONCE, "revisit-images") as pool:
            list(pool.map(self._write, images.keys(), images.values()))

    def await_removals(self) -> None:
        """Wait for removals that may have begun before the rows which are committed now; raises StorageFailed."""

        def wait(first: int) -> None:
            with self._locked(f"{first:02x}"):
                pass

        with ThreadPoolExecutor(AT_ONCE, "revisit-images") as pool:
            list(pool.map(wait, range(256)))

    def read(self, digest: str) -> bytes:
        """The bytes of an image.

        Raises
        ------
        Damaged
            The object is missing or does not hold these bytes.
        StorageFailed
            The store does not answer now.
        """
        if not DIGEST.fullmatch(digest):
            raise Damaged(f"the stored SHA-256 of its image, {digest!r}, is none; enrol the image again")
        name = f"{self.address}/{digest[:2]}/{digest[2:4]}/{digest}"
        with translated(self.address):
            try:
                answer = self._client.get_object(Bucket=self._bucket, Key=self._key(digest))
                with answer["Body"] as body:
                    image = bytes(body.read())
            except self._client.exceptions.ClientError as error:
                if code_of(error) in MISSING:
                    raise Damaged(LOST.format(name, "is missing")) from None
                raise
        if hashlib.sha256(image).hexdigest() != digest:
            raise Damaged(LOST.format(name, "does not hold what was enrolled" if image else "is empty"))
        return image

    def read_each(self, digests: Sequence[str]) -> list[bytes | Damaged]:
        """The bytes of each image, or the Damaged that `read` would raise; raises StorageFailed."""
        with ThreadPoolExecutor(AT_ONCE, "revisit-images") as pool:
            return list(pool.map(partial(damaged_or, self.read), digests))

    def discard(self, digests: Iterable[str]) -> Discarded:
        """Remove images that no view needs, after their rows were deleted.

        While the store is away they stay in `left`; `problem` removes them once it answers, or else the next start.
        """
        named = sorted({digest for digest in digests if DIGEST.fullmatch(digest)})
        groups = [list(group) for _, group in groupby(named, key=lambda digest: digest[:2])]
        with ThreadPoolExecutor(AT_ONCE, "revisit-images") as pool:
            done = list(pool.map(self._discard, groups))
        return Discarded(sum(some.removed for some in done), frozenset[str]().union(*(some.needed for some in done)))

    @property
    def left(self) -> frozenset[str]:
        """Digests of images that `discard` could not remove yet, while the store or the database was away."""
        return frozenset(self._left)

    def sweep(self) -> int:
        """Remove images without a view, which a crash left; returns how many."""
        removed = 0
        for page in self._pages():
            named = sorted(name for name in page if DIGEST.fullmatch(name))
            for first, group in groupby(named, key=lambda digest: digest[:2]):
                with self._locked(first) as hold:
                    removed += self._remove(list(group), hold).removed
            if self._closing.is_set():
                break
        return removed

    def sweep_at_start(self) -> None:
        """Begin to sweep: of millions of objects it takes minutes."""
        if self._sweeper is None:
            self._sweeper = threading.Thread(target=self._sweep_quietly, name="revisit-sweep", daemon=True)
            self._sweeper.start()

    def names(self) -> Iterator[str]:
        """The names of all objects below the prefix, without it; raises StorageFailed."""
        with translated(self.address):
            pages = self._client.get_paginator("list_objects_v2").paginate(Bucket=self._bucket, Prefix=self._prefix)
            for page in pages:
                for found in page.get("Contents", ()):
                    yield str(found["Key"]).removeprefix(self._prefix)

    @property
    def owner_name(self) -> str:
        """Address of the object that `owner` reads."""
        return f"{self.address}/{OWNER}"

    def owner(self) -> str | None:
        """The id of the database that the images belong to; None where that is not recorded. Raises StorageFailed."""
        try:
            return owner_file.read(self.prompt.read(OWNER))
        except FileNotFoundError:
            return None

    def claim(self, owner: str) -> None:
        """Record which database the images belong to; raises DiskFull, StorageFailed."""
        self.files.write(OWNER, owner_file.written(owner))

    def holds_any(self) -> bool:
        """Whether there is an image, of a view or not; raises StorageFailed."""
        return any(self._pages())

    def problem(self) -> str | None:
        """Why images cannot be read or written now, or None; within some 6 s."""
        try:
            with translated(self.address):
                self._probing.list_objects_v2(Bucket=self._bucket, Prefix=self._prefix, MaxKeys=1)
                if self._trouble:
                    self._probing.put_object(Bucket=self._bucket, Key=self._prefix + PROBE, Body=b"")
                    self._probing.delete_object(Bucket=self._bucket, Key=self._prefix + PROBE)
                    self._trouble = False
        except RevisitError as error:
            return error.detail
        if self._left:
            self.discard(list(self._left))
        return None

    def close(self) -> None:
        """End a sweep and the connections."""
        self._closing.set()
        if self._sweeper is not None:
            self._sweeper.join()
        self._client.close()
        self._probing.close()

    def _key(self, digest: str) -> str:
        if not DIGEST.fullmatch(digest):
            raise ValueError(f"{digest!r} is no SHA-256")
        return f"{self._prefix}{digest[:2]}/{digest[2:4]}/{digest}"

    def _write(self, digest: str, image: bytes) -> None:
        """Write an image, also over one that is there: it may have been damaged since."""
        sent = base64.b64encode(bytes.fromhex(digest)).decode()
        self._trouble, before = True, self._trouble
        try:
            with translated(self.address):
                self._client.put_object(Bucket=self._bucket, Key=self._key(digest), Body=image, ChecksumSHA256=sent)
        except RevisitError as error:
            if not before:
                log.error("images cannot be stored: %s", error.detail, extra={"event": "image_store_failed"})
            raise
        self._trouble = False

    def _discard(self, digests: list[str]) -> Discarded:
        try:
            with self._locked(digests[0][:2]) as hold:
                done = self._remove(digests, hold)
        except RevisitError as error:
            log.warning("%d images of deleted views are not removed yet: %s", len(digests), error.detail)
            self._left.update(digests)
            return Discarded(0, frozenset(self._owned(digests)))
        self._left.difference_update(digests)
        return done

    def _remove(self, digests: list[str], hold: ImageHold) -> Discarded:
        """Remove those that no view needs, as long as their lock is held; raises StorageFailed."""
        hold.await_commits()
        needed = self._owned(digests)
        needless = sorted(set(digests) - needed)
        with translated(self.address):
            for digest in needless:
                hold.check()
                self._client.delete_object(Bucket=self._bucket, Key=self._key(digest))
        return Discarded(len(needless), frozenset(needed))

    def _pages(self) -> Iterator[list[str]]:
        """Last parts of the names of all objects at the place of an image, many at a time."""
        page: list[str] = []
        for name in self.names():
            digest = name[-64:]
            if name == f"{digest[:2]}/{digest[2:4]}/{digest}":
                page.append(digest)
            if len(page) >= 1000:
                yield page
                page = []
        yield page

    def _sweep_quietly(self) -> None:
        try:
            removed = self.sweep()
        except RevisitError as error:
            log.error("images that a crash left could not be removed: %s; the next start tries again", error.detail)
        else:
            log.info("%d images that a crash left were removed", removed)
