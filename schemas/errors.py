"""All errors of revisit, with stable codes.

::

    RevisitError
    ├── BadBody            no-picture, malformed-body; BadSnapshot malformed-body
    ├── BadImage           not-a-picture, undecodable-picture, picture-too-large, picture-too-small
    ├── BodyTooLarge       body-too-large        UnexpectedBody unexpected-body
    ├── RequestTimeout     request-timeout       RangeOutside range-not-satisfiable
    ├── InvalidParameters  invalid-parameter (all of them listed at once)
    ├── NothingStatic      nothing-static        PoorImage   poor-picture
    ├── NotFound           not-found             ImageNotKept image-not-kept
    ├── ViewDeleted        not-found             (in reports of imports)
    ├── Conflict           conflict              BlurChanged, RecipeChanged, Cancelled conflict
    ├── KeyReused          idempotency-key-reused
    ├── Unauthorized       unauthorized          Forbidden   forbidden       OtherSite other-site
    ├── Busy               too-many-requests     Unavailable, StorageFailed, EncoderAway  unavailable
    ├── DiskFull           disk-full
    ├── Damaged            damaged               (also the failure code of a view whose stored data is damaged)
    ├── LeaseLost          lease-lost            (in workers; never sent to a client)
    ├── CallerGone         caller-gone           (nobody is left to be sent it)
    ├── DescriptorMismatch descriptor-mismatch   (descriptors do not fit the vocabulary)
    └── SetupError         setup                 (the service cannot start as it is configured)

Clients branch on the code; the text says what was wrong, what was seen and what to do, and may change.
`app.http.problems` maps codes to HTTP statuses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

LONGEST_ECHO = 100
"""Characters of a name that a refusal repeats."""

MOST_MISTAKES = 100
"""Mistakes of one request that its refusal lists: thousands take seconds to write, and nobody reads them."""

NOT_CALLED = "{} cannot be called: {}; see HTTP_PROXY, HTTPS_PROXY, ALL_PROXY, NO_PROXY, SSL_CERT_FILE and SSL_CERT_DIR"
"""Of the setting that names a service, and why: what a SetupError says of an environment that cannot be used."""


def unforeseen(error: Exception) -> str:
    """What is said, beside the code ``internal``, of a job that failed by a fault of the program."""
    return f"{type(error).__name__}; the service's log has the details"


def echoed(name: str) -> str:
    """A name as a refusal repeats it: whole, or its beginning and its length."""
    return name if len(name) <= LONGEST_ECHO else f"{name[:LONGEST_ECHO]}… ({len(name)} characters)"


@dataclass(frozen=True)
class ParameterError:
    """An invalid parameter.

    Parameters
    ----------
    parameter : str
        Its name as the client wrote it, cut to `LONGEST_ECHO`, with a path for nested values (``metadata.colour``).
    detail : str
        The value seen and what is allowed.
    """

    parameter: str
    detail: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameter", echoed(self.parameter))


class RevisitError(Exception):
    """Base of all errors; `code` is stable, `detail` is for people."""

    code = "internal"

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class BadBody(RevisitError):
    """The request's body holds no image, or cannot be parsed."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


class BadSnapshot(BadBody):
    """A file that is no snapshot, or not as it was written; nothing of it was restored."""

    def __init__(self, detail: str) -> None:
        super().__init__("malformed-body", f"the snapshot is refused, and nothing was changed: {detail}")


class BadImage(RevisitError):
    """Bytes that are not an accepted image."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


class BodyTooLarge(RevisitError):
    """A request body larger than the limit."""

    code = "body-too-large"


class UnexpectedBody(RevisitError):
    """A body on a request that takes none."""

    code = "unexpected-body"


class RequestTimeout(RevisitError):
    """A request that did not arrive in time."""

    code = "request-timeout"


class RangeOutside(RevisitError):
    """A part was asked for that begins behind the end of a body of `size` bytes."""

    code = "range-not-satisfiable"

    def __init__(self, size: int) -> None:
        super().__init__(f"the file has {size:,} bytes, and none of those that `Range` names")
        self.size = size


class InvalidParameters(RevisitError):
    """One or more parameters are unknown, of a wrong type or out of range; `errors` lists up to `MOST_MISTAKES`."""

    code = "invalid-parameter"

    def __init__(self, errors: Sequence[ParameterError]) -> None:
        self.errors = tuple(errors[:MOST_MISTAKES])
        more = "; and more" if len(errors) > MOST_MISTAKES else ""
        super().__init__("; ".join(f"{e.parameter}: {e.detail}" for e in self.errors) + more)

    @classmethod
    def of(cls, parameter: str, detail: str) -> "InvalidParameters":
        """Refuse one parameter."""
        return cls([ParameterError(parameter, detail)])


class PoorImage(RevisitError):
    """An image that is dark, blurred, shows mostly what moves or adds nothing, and was not to be enrolled then."""

    code = "poor-picture"


class NothingStatic(RevisitError):
    """Every cell of the image has a dynamic label: nothing is left to recognise the place by."""

    code = "nothing-static"


class NotFound(RevisitError):
    """An unknown map, view, job or query."""

    code = "not-found"

    def __init__(self, kind: str, name: str, hint: str = "") -> None:
        super().__init__(f"there is no {kind} {echoed(name)!r}" + (f"; {hint}" if hint else ""))


class ViewDeleted(RevisitError):
    """An image of an import whose view was deleted meanwhile: it is not to come back."""

    code = NotFound.code


class NoPose(RevisitError):
    """Nothing is sure, or views of the place have no geographic position."""

    code = "no-pose"


class ImageNotKept(RevisitError):
    """The image of a view whose map keeps no images."""

    code = "image-not-kept"

    def __init__(self, view_id: str) -> None:
        super().__init__(f"the map of the view {view_id} keeps no images: this one was removed when it was described")


class Conflict(RevisitError):
    """The request contradicts stored data or a running job."""

    code = "conflict"


class Cancelled(Conflict):
    """Somebody cancelled the description of an image, which is described where it is sent again.

    Attributes
    ----------
    failure : str
        Code of the failure of its view, and of its job.
    """

    failure = "cancelled"


class ImageEnrolled(Conflict):
    """A map has an image already, with other attributes than it is enrolled with now."""


class BlurChanged(Conflict):
    """A map blurs other things than were blurred in an image that is about to be stored: it is to be blurred anew."""


class RecipeChanged(Conflict):
    """A map has another recipe or ranking than the one that its next recipe was made from: it is to be made anew."""


class KeyReused(RevisitError):
    """An Idempotency-Key was used again with another request."""

    code = "idempotency-key-reused"


class Unauthorized(RevisitError):
    """The API key is missing or wrong."""

    code = "unauthorized"


class Forbidden(RevisitError):
    """The API key does not allow this."""

    code = "forbidden"


class OtherSite(RevisitError):
    """A web page of another site sent this to a service without keys."""

    code = "other-site"


class Busy(RevisitError):
    """A queue of the service is full.

    Parameters
    ----------
    detail : str
    retry_after_s : int
        Estimated seconds until the queue is empty: its length times the measured time per image.
    """

    code = "too-many-requests"

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s

    @classmethod
    def queue(cls, waiting: int, pace_s: float, kind: str) -> "Busy":
        """The error for a queue full with `waiting` requests of a kind, at `pace_s` seconds each."""
        wait = max(1, math.ceil(waiting * pace_s))
        return cls(f"{waiting} {kind} are waiting, as many as are let in; try again in {wait} s", wait)


class Unavailable(Busy):
    """The service cannot answer now: it starts, stops, is overtaken by deletions, has no worker or is crowded."""

    code = "unavailable"


class EncoderAway(Unavailable):
    """The shared encoder cannot be reached, does not answer in time, is full, or has other weights."""


class EncoderFails(EncoderAway):
    """The encoder of this process fails on a plain image as well: the one that it failed on is not to blame."""


class DiskFull(RevisitError):
    """The disk is full; reading and deleting still work."""

    code = "disk-full"


class StorageFailed(Unavailable):
    """The disk cannot be written or read; the service goes on by itself when it can."""

    def __init__(self, detail: str) -> None:
        super().__init__(detail, 5)


class Damaged(RevisitError):
    """What is stored is not what was stored: a file or a row does not fit its checksum, or cannot be read."""

    code = "damaged"


class LeaseLost(RevisitError):
    """A worker reported on a job that another worker has claimed meanwhile, or that was cancelled or deleted."""

    code = "lease-lost"


class JobStopped(Exception):
    """The worker that does a job stops: the job is put back, and nothing is wrong with it."""


class CallerGone(RevisitError):
    """Whoever asked has closed the connection before anything was done."""

    code = "caller-gone"

    def __init__(self) -> None:
        super().__init__("the caller closed the connection before the turn of this request came")


class DescriptorMismatch(RevisitError):
    """Descriptors and vocabulary have different numbers of channels."""

    code = "descriptor-mismatch"

    def __init__(self, *, got: int, want: int) -> None:
        super().__init__(
            f"descriptors have {got} channels but the vocabulary has {want}; train one for this encoder with "
            "`./revisit vocabulary train`"
        )


class SetupError(RevisitError):
    """The service cannot start as it is configured; the text says what to change."""

    code = "setup"
