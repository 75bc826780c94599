"""Every refusal of revisit, with a code that stays.

::

    RevisitError
    ├── BadBody            no-picture, malformed-body
    ├── BadImage         not-a-picture, undecodable-picture, picture-too-large, picture-too-small
    ├── BodyTooLarge       body-too-large
    ├── InvalidParameters  invalid-parameter (all of them listed at once)
    ├── NothingStatic      nothing-static
    ├── NotFound           not-found
    ├── Conflict           conflict
    ├── KeyReused          idempotency-key-reused
    ├── Unauthorized       unauthorized          Forbidden   forbidden
    ├── Busy               too-many-requests     Unavailable unavailable
    ├── DiskFull           disk-full
    ├── LeaseLost          (a worker came too late; never reaches a client)
    ├── DescriptorMismatch (two parts of a recipe do not fit)
    └── SetupError         (the service cannot start as it is configured)

Clients switch on the code; the text says what was wrong, what was seen and what to do, and may change.
HTTP statuses are the business of `app.http.problems`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ParameterError:
    """One parameter that cannot be used.

    Parameters
    ----------
    parameter : str
        Its name as the client wrote it, with a path for nested values (``metadata.colour``).
    detail : str
        What was seen and what is allowed.
    """

    parameter: str
    detail: str


class RevisitError(Exception):
    """Something asked of revisit that it refuses, and why."""

    code = "internal"

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class BadBody(RevisitError):
    """The request's body holds no image, or cannot be taken apart."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


class BadImage(RevisitError):
    """Bytes that are not a usable image."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


class BodyTooLarge(RevisitError):
    """More bytes than the service takes in one request."""

    code = "body-too-large"


class InvalidParameters(RevisitError):
    """One or more parameters are unknown, of a wrong type or out of range; `errors` lists all of them."""

    code = "invalid-parameter"

    def __init__(self, errors: Sequence[ParameterError]) -> None:
        super().__init__("; ".join(f"{e.parameter}: {e.detail}" for e in errors))
        self.errors = tuple(errors)

    @classmethod
    def of(cls, parameter: str, detail: str) -> "InvalidParameters":
        """Refuse one parameter."""
        return cls([ParameterError(parameter, detail)])


class NothingStatic(RevisitError):
    """Every pixel of the image belongs to something that moves: there is nothing to know the place by."""

    code = "nothing-static"


class NotFound(RevisitError):
    """An unknown map, view, job or query."""

    code = "not-found"

    def __init__(self, kind: str, name: str, hint: str = "") -> None:
        super().__init__(f"there is no {kind} {name!r}" + (f"; {hint}" if hint else ""))


class Conflict(RevisitError):
    """The request contradicts what is already there or under way."""

    code = "conflict"


class KeyReused(RevisitError):
    """An Idempotency-Key came again with another request."""

    code = "idempotency-key-reused"


class Unauthorized(RevisitError):
    """No key, or a wrong one."""

    code = "unauthorized"


class Forbidden(RevisitError):
    """A right key that does not open this."""

    code = "forbidden"


class Busy(RevisitError):
    """More work is waiting than the service takes on.

    Parameters
    ----------
    retry_after_s : int
        Seconds after which the queue will have drained, from its length and the measured time per image.
    """

    code = "too-many-requests"

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s

    @classmethod
    def queue(cls, waiting: int, pace_s: float, kind: str) -> "Busy":
        """Refuse because `waiting` requests of a kind, at `pace_s` seconds each, are as many as are let in."""
        wait = max(1, math.ceil(waiting * pace_s))
        return cls(f"{waiting} {kind} are waiting, as many as are let in; try again in {wait} s", wait)


class Unavailable(Busy):
    """The service is starting or stopping."""

    code = "unavailable"


class DiskFull(RevisitError):
    """Nothing more can be written; reading and deleting still work."""

    code = "disk-full"


class LeaseLost(RevisitError):
    """A worker finished a job that was meanwhile given to another, or deleted."""

    code = "lease-lost"


class DescriptorMismatch(RevisitError):
    """Descriptors and vocabulary (or two descriptions) come from different encoders."""

    code = "descriptor-mismatch"

    def __init__(self, *, got: int, want: int) -> None:
        super().__init__(
            f"descriptors have {got} channels but the vocabulary has {want}; train one for this encoder with "
            "`./revisit vocabulary train`"
        )


class SetupError(RevisitError):
    """The service cannot start as it is configured; the text says what to change."""

    code = "setup"
