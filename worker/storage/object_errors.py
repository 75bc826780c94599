"""Errors of an S3-compatible store, as errors of revisit: away, refused, without the bucket, or full."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from botocore.exceptions import BotoCoreError, ClientError, NoCredentialsError, PartialCredentialsError

from schemas.errors import DiskFull, RevisitError, StorageFailed

MISSING = frozenset({"NoSuchKey", "404", "NotFound"})
_DENIED = frozenset({"AccessDenied", "403", "Forbidden", "InvalidAccessKeyId", "SignatureDoesNotMatch", "ExpiredToken"})
_FULL = frozenset({"XMinioStorageFull", "QuotaExceeded", "InsufficientStorage", "InsufficientCapacity", "507"})

AWAY = "the image store {} cannot be reached ({}); try again in a moment, the service goes on by itself"
BUSY = "the image store {} cannot serve now ({}); try again in a moment, the service goes on by itself"
DENIED = (
    "the image store {} refuses access ({}): whoever runs the service should see its credentials (AWS_ACCESS_KEY_ID, "
    "AWS_SECRET_ACCESS_KEY) and what they may do in the bucket"
)
NO_CREDENTIALS = "the image store {} was not asked: no credentials; set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
NO_BUCKET = "the image store {} has no such bucket; whoever runs the service should make it, or see REVISIT_IMAGES"
FULL = "the image store {} is full ({}); free some space or delete views"


def code_of(error: ClientError) -> str:
    """The store's code of an error, such as ``NoSuchKey``; the HTTP status where it sent none."""
    response: dict[str, Any] = error.response
    return str(response.get("Error", {}).get("Code") or response.get("ResponseMetadata", {}).get("HTTPStatusCode", ""))


def problem_of(error: BotoCoreError | ClientError, address: str) -> RevisitError:
    """DiskFull or StorageFailed, in words.

    Parameters
    ----------
    error : BotoCoreError or ClientError
    address : str
        Of the store, for the text.
    """
    if isinstance(error, NoCredentialsError | PartialCredentialsError):
        return StorageFailed(NO_CREDENTIALS.format(address))
    if not isinstance(error, ClientError):
        return StorageFailed(AWAY.format(address, type(error).__name__))
    code = code_of(error)
    status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode")
    if code == "NoSuchBucket":
        return StorageFailed(NO_BUCKET.format(address))
    if code in _FULL or status == 507:
        return DiskFull(FULL.format(address, code))
    if code in _DENIED or status in (401, 403):
        return StorageFailed(DENIED.format(address, code))
    return StorageFailed(BUSY.format(address, code))


@contextmanager
def translated(address: str) -> Iterator[None]:
    """Raise errors of the store inside the block as DiskFull or StorageFailed."""
    try:
        yield
    except (BotoCoreError, ClientError) as error:
        raise problem_of(error, address) from error
