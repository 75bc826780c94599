"""Exceptions of the client."""

import email.utils
import re
from datetime import UTC, datetime
from typing import Any

import httpx
from pydantic import ValidationError

from revisit_client import wire


def without_password(url: str) -> str:
    """An address as messages show it: without what stands before its host, a user and a password maybe."""
    return re.sub(r"^([a-z][a-z0-9+.-]*://)?.*@", r"\1***@", url, flags=re.IGNORECASE | re.DOTALL)


class ClientError(Exception):
    """A call failed; base of the exceptions below. All of them can be pickled: pools of processes pass them on."""


class Unsendable(ClientError, ValueError):
    """A name, an id, a key or a file with which no call can be made; nothing was sent."""


class Unreachable(ClientError):
    """No service answers at an address, or it stopped answering."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(
            f"no service answers at {url} ({reason}); start one with `./revisit serve`, "
            "or set REVISIT_URL to where it runs"
        )
        self.url = url
        self._reason = reason

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.url, self._reason), self.__dict__


class RevisitProblem(ClientError):
    """The service refused a call (problem details, RFC 9457).

    Attributes
    ----------
    type : str
        Stable URN; `code` is its last part, such as ``picture-too-large``.
    title, detail : str
        Text for people; it may change.
    status : int
        HTTP status.
    errors : list of wire.ProblemParameter
        All parameters that cannot be used.
    request_id : str
        Id of the call in the service's log.
    retry_after_s : float or None
        Seconds after which to try again, where the service says so.
    replayed : bool
        Whether it is the answer to an earlier call with this Idempotency-Key, given again: no repetition gets another.
    """

    def __init__(self, problem: wire.Problem, retry_after_s: float | None = None, replayed: bool = False) -> None:
        # The detail of several parameters is all of theirs in one line: here each has a line of its own.
        several = [f"  {error.parameter}: {error.detail}" for error in problem.errors if len(problem.errors) > 1]
        text = problem.title if several or not problem.detail else f"{problem.title}: {problem.detail}"
        super().__init__("\n".join([text, *several]))
        self.type = problem.type
        self.code = problem.type.rpartition(":")[2]
        self.title = problem.title
        self.status = problem.status
        self.detail = problem.detail
        self.errors = problem.errors
        self.request_id = problem.request_id
        self.retry_after_s, self.replayed = retry_after_s, replayed
        self._problem = problem

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._problem, self.retry_after_s, self.replayed), self.__dict__


class JobFailed(ClientError):
    """The job of `wait_for_job` failed or was cancelled; `job` says why."""

    def __init__(self, job: wire.Job) -> None:
        reason = f"{job.failure.code}: {job.failure.detail}" if job.failure else "no reason given"
        super().__init__(f"job {job.id} {job.state}: {reason}")
        self.job = job

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.job,), self.__dict__


def reason(error: httpx.RequestError) -> str:
    """Why no service answered, as text for people."""
    if isinstance(error, httpx.ConnectError):
        return "connection refused" if "refused" in str(error).lower() else str(error) or "cannot connect"
    if isinstance(error, httpx.TimeoutException):
        return "no answer in time"
    return str(error) or type(error).__name__


def retry_after(answer: httpx.Response) -> float | None:
    """Seconds of the Retry-After header, given as a number or (by a proxy) as a date; None without one."""
    text = answer.headers.get("retry-after")
    if text is None:
        return None
    try:
        return max(0.0, float(text))
    except ValueError:
        pass
    try:
        return max(0.0, (email.utils.parsedate_to_datetime(text) - datetime.now(UTC)).total_seconds())
    except (TypeError, ValueError):
        return None


def is_replayed(answer: httpx.Response) -> bool:
    """Whether an answer is that to an earlier call with the same Idempotency-Key."""
    return "idempotent-replayed" in answer.headers


def problem_of(answer: httpx.Response) -> wire.Problem:
    """The problem in an answer; made from the status when the answer (a proxy's) is no problem+json."""
    try:
        return wire.Problem.model_validate(answer.json(), extra="ignore")
    except (ValidationError, ValueError):
        there = answer.headers.get("location", "") if answer.is_redirect else ""
        moved = without_password(there.partition("?")[0])[:200]
        return wire.Problem(
            type="about:blank",
            title=f"HTTP {answer.status_code} {answer.reason_phrase}".strip(),
            status=answer.status_code,
            detail=f"the address redirects to {moved}; give that one" if moved else answer.text.strip()[:200],
            request_id=answer.headers.get("x-request-id", ""),
        )
