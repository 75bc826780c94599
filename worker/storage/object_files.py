"""Files of any size in an S3-compatible store, beside the images: recordings under import, and snapshots.

A file is whole or not there. The store compares each part of it with a SHA-256 while it is sent; a reader whose
connection breaks goes on where it was.
"""

import base64
import hashlib
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

from botocore.exceptions import BotoCoreError, ClientError

from worker.storage.object_errors import MISSING, code_of, translated

PART_BYTES = 16 * 1024 * 1024
"""Of one call of an upload, unless the file has more than `MOST_PARTS` of them."""

MOST_PARTS = 9_000
"""Stores take 10,000."""

PIECE_BYTES = 4 * 1024 * 1024
"""Read at a time."""

READ_ATTEMPTS = 3
"""Times that one place of a file is read when its connection breaks; each is a call with attempts of its own."""

GONE = MISSING | {"NoSuchUpload"}


class Stored(NamedTuple):
    """An object, or the parts of one whose upload has not ended: then `upload` names that.

    `age_s` is by the store's clock.
    """

    name: str
    size: int
    age_s: float
    upload: str | None = None


def _nothing() -> None:
    """Does nothing, where nobody follows the progress."""


class ObjectFiles:
    """Files below a prefix of a bucket. Methods raise DiskFull or StorageFailed when the store fails.

    Parameters
    ----------
    client
        Of boto3.
    address : str
        ``s3://bucket/prefix``, for texts.
    bucket, prefix : str
        The prefix is empty or ends with a slash.
    """

    def __init__(self, client: Any, address: str, bucket: str, prefix: str) -> None:
        self.address = address
        self._client, self._bucket, self._prefix = client, bucket, prefix

    def put(self, path: Path, name: str, on_progress: Callable[[], None] = _nothing) -> str:
        """Store a file; returns its SHA-256.

        `on_progress` is called before each part; what it raises ends the upload.
        """
        whole = hashlib.sha256()
        size = path.stat().st_size
        part = max(PART_BYTES, -(-size // MOST_PARTS))
        with path.open("rb") as file, translated(self.address):
            if size > part:
                self._put_parts(file, name, part, whole, on_progress)
            else:
                on_progress()
                body = file.read()
                whole.update(body)
                self._client.put_object(**self._of(name), Body=body, ChecksumSHA256=_base64(whole.digest()))
        return whole.hexdigest()

    def _put_parts(self, file: BinaryIO, name: str, part: int, whole: Any, on_progress: Callable[[], None]) -> None:
        begun = self._client.create_multipart_upload(**self._of(name), ChecksumAlgorithm="SHA256")
        upload = {**self._of(name), "UploadId": begun["UploadId"]}
        parts: list[dict[str, Any]] = []
        try:
            while body := file.read(part):
                on_progress()
                whole.update(body)
                sent = {"PartNumber": len(parts) + 1, "ChecksumSHA256": _base64(hashlib.sha256(body).digest())}
                answer = self._client.upload_part(**upload, **sent, Body=body)
                parts.append({**sent, "ETag": answer["ETag"]})
            self._client.complete_multipart_upload(**upload, MultipartUpload={"Parts": parts})
        except BaseException:
            with suppress(BotoCoreError, ClientError):  # then a sweep ends it
                self._client.abort_multipart_upload(**upload)
            raise

    def write(self, name: str, body: bytes) -> None:
        """Store some bytes under a name."""
        with translated(self.address):
            sent = _base64(hashlib.sha256(body).digest())
            self._client.put_object(**self._of(name), Body=body, ChecksumSHA256=sent)

    def read(self, name: str) -> bytes:
        """All bytes of a small file; raises FileNotFoundError."""
        with self.open(name) as file:
            return file.read()

    def open(self, name: str) -> BinaryIO:
        """A file, for reading; raises FileNotFoundError. Errors of the store while it is read are raised by `read`."""
        with translated(self.address), _missing(name):
            about = self._client.head_object(**self._of(name))
        reader = _Reader(self._client, self._of(name), self.address, about["ContentLength"], about["ETag"])
        return cast(BinaryIO, io.BufferedReader(reader, 64 * 1024))

    def fetch(self, name: str, path: Path, on_progress: Callable[[int], None]) -> str:
        """Copy a file to a new one on the disk; returns its SHA-256; raises FileNotFoundError.

        `on_progress` is called with the number of bytes before each piece is written; what it raises ends the copying.
        """
        digest = hashlib.sha256()
        with self.open(name) as source, path.open("xb") as file:
            while piece := source.read(PIECE_BYTES):
                on_progress(len(piece))
                digest.update(piece)
                file.write(piece)
        return digest.hexdigest()

    def size(self, name: str) -> int:
        """Bytes of a file; raises FileNotFoundError."""
        with translated(self.address), _missing(name):
            return int(self._client.head_object(**self._of(name))["ContentLength"])

    def age_s(self, name: str) -> float:
        """Seconds since a file was written, by the store's clock; raises FileNotFoundError."""
        with translated(self.address), _missing(name):
            about = self._client.head_object(**self._of(name))
        return _age_s(about, about["LastModified"])

    def below(self, folder: str) -> Iterator[Stored]:
        """The files whose names begin with ``folder/``."""
        with translated(self.address):
            pages = self._client.get_paginator("list_objects_v2")
            for page in pages.paginate(Bucket=self._bucket, Prefix=f"{self._prefix}{folder}/"):
                for found in page.get("Contents", ()):
                    age_s = _age_s(page, found["LastModified"])
                    yield Stored(self._name(found["Key"]), int(found["Size"]), age_s)

    def unfinished(self, folder: str) -> Iterator[Stored]:
        """Uploads of such files that have not ended: their process works on them, or was killed."""
        with translated(self.address):
            pages = self._client.get_paginator("list_multipart_uploads")
            for page in pages.paginate(Bucket=self._bucket, Prefix=f"{self._prefix}{folder}/"):
                for found in page.get("Uploads", ()):
                    age_s = _age_s(page, found["Initiated"])
                    yield Stored(self._name(found["Key"]), 0, age_s, str(found["UploadId"]))

    def remove(self, name: str, upload: str | None = None) -> None:
        """Remove a file, or what there is of an upload that has not ended; does nothing when there is none."""
        with translated(self.address):
            try:
                if upload is None:
                    self._client.delete_object(**self._of(name))
                else:
                    self._client.abort_multipart_upload(**self._of(name), UploadId=upload)
            except ClientError as error:
                if code_of(error) not in GONE:
                    raise

    def _of(self, name: str) -> dict[str, str]:
        return {"Bucket": self._bucket, "Key": self._prefix + name}

    def _name(self, key: str) -> str:
        return key.removeprefix(self._prefix)


class _Reader(io.RawIOBase):
    """The bytes of one object, from any place on."""

    def __init__(self, client: Any, of: dict[str, str], address: str, size: int, tag: str) -> None:
        super().__init__()
        self._client, self._of, self._address, self._size, self._tag = client, of, address, size, tag
        self._at = 0
        self._body: Any = None

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        if at != self._at:
            self._drop()
            self._at = at
        return at

    def readinto(self, buffer: Any) -> int:
        count = min(len(buffer), self._size - self._at)
        if count <= 0:
            return 0
        with translated(self._address):
            piece = self._piece(count)
        buffer[: len(piece)] = piece
        self._at += len(piece)
        return len(piece)

    def _piece(self, count: int) -> bytes:
        for _ in range(READ_ATTEMPTS - 1):
            with suppress(BotoCoreError):  # the connection broke, or was silent; a refusal is a ClientError
                return self._read_on(count)
        return self._read_on(count)

    def _read_on(self, count: int) -> bytes:
        try:
            if self._body is None:
                with _missing(self._of["Key"]):
                    wanted = {"Range": f"bytes={self._at}-", "IfMatch": self._tag}
                    self._body = self._client.get_object(**self._of, **wanted)["Body"]
            return bytes(self._body.read(count))
        except BotoCoreError:
            self._drop()
            raise

    def _drop(self) -> None:
        if self._body is not None:
            self._body.close()
            self._body = None

    def close(self) -> None:
        self._drop()
        super().close()


@contextmanager
def _missing(name: str) -> Iterator[None]:
    """Raise FileNotFoundError where a block finds that there is no such object."""
    try:
        yield
    except ClientError as error:
        if code_of(error) in MISSING:
            raise FileNotFoundError(name) from None
        raise


def _age_s(answer: dict[str, Any], since: datetime) -> float:
    """Seconds since a moment of the store's clock, by the date of its answer."""
    date = answer.get("ResponseMetadata", {}).get("HTTPHeaders", {}).get("date")
    now = parsedate_to_datetime(date) if date else datetime.now(UTC)
    return (now - since).total_seconds()


def _base64(digest: bytes) -> str:
    return base64.b64encode(digest).decode()
