"""HTTP requests to a service, repeated while it is busy, starting or its answer got lost."""

import ipaddress
import logging
import os
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from revisit_client import wire
from revisit_client.errors import (
    ClientError,
    RevisitProblem,
    Unreachable,
    Unsendable,
    is_replayed,
    problem_of,
    reason,
    retry_after,
    without_password,
)

log = logging.getLogger("revisit_client")

USER_AGENT = "revisit-client"

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 8.0
"""Seconds between repetitions without Retry-After: each pause is twice the previous one."""

GATEWAY = (502, 504)
"""What a gateway answers for a service that it does not reach; the service itself never does."""

PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "https_proxy", "all_proxy")

Answer = TypeVar("Answer", bound=BaseModel)
Page = TypeVar("Page", wire.Views, wire.Places, wire.Jobs)

MAYBE_DELETED = "; it may have been deleted by this very call, which was sent before and whose answer got lost"


class Connection:
    """The connections to one service.

    Parameters
    ----------
    url : str
        Address of the service, without a slash at its end.
    key : str or None
        Sent with every request; None sends none.
    timeout : float
        Seconds without anything from the service after which an answer is given up; one that keeps coming is not.
    patience : float
        Seconds over which a request is repeated.
    transport : httpx.BaseTransport or None
        None for the network.
    sleep, clock : callable
        Both in seconds.
    """

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout: float,
        patience: float,
        transport: httpx.BaseTransport | None,
        sleep: Callable[[float], None],
        clock: Callable[[], float],
    ) -> None:
        self.url = without_password(url)  # as messages show it
        self._patience, self._sleep, self._clock = patience, sleep, clock
        # Whether the service answered, and was not waited for in vain since: it may be starting again where it refuses
        # the connection, or a gateway does not reach it.
        self._there = False
        self._missed = False  # whether it was said that it is waited for
        usual = httpx.Timeout(timeout, connect=min(5.0, timeout))
        # For what is answered once all that was sent is stored, in an object store say: that takes as long as it takes.
        self.until_stored = httpx.Timeout(timeout, connect=usual.connect, read=None)
        self._made: dict[str, Any] = {
            "base_url": _address(url),
            "timeout": usual,
            "transport": transport,
            "headers": {"user-agent": USER_AGENT} | _bearing(key),
        }
        self._process, self._client = os.getpid(), _client(**self._made)

    @property
    def _http(self) -> httpx.Client:
        """The connections of this process: two that shared one after a fork would read each other's answers."""
        if self._process != os.getpid() and not self._client.is_closed:
            self._process, self._client = os.getpid(), _client(**self._made)
        return self._client

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def receive(self, model: type[Answer], method: str, path: str, **request: Any) -> Answer:
        """Send a request as `send` does, and validate its answer as `model`.

        Raises
        ------
        RevisitProblem, Unreachable
        ClientError
            The answer is not one of revisit's.
        """
        answer = self.send(method, path, **request)
        try:
            # A newer service may add fields that this client does not know.
            return model.model_validate(answer.json(), extra="ignore")
        except (ValidationError, ValueError) as error:
            what = "is not revisit's, or of a version before this client's"
            raise ClientError(f"{self.url} answered something that {what}: {error}") from error

    def stream(self, path: str) -> Iterator[bytes]:
        """The body of an answer to GET, in pieces, asked for as `send` does.

        Where its connection breaks, the rest of it is asked for, if the service gives parts and says which body it is:
        until nothing more has come for `patience` seconds.

        Raises
        ------
        RevisitProblem, Unreachable
        """
        headers = {"accept-encoding": "identity"}  # parts are those of what is kept, not of what a proxy made of it
        answer = self.send("GET", path, stream=True, headers=headers)
        tag = answer.headers.get("etag", "")
        in_parts = answer.headers.get("accept-ranges") == "bytes" and tag.startswith('"')
        come, pause = 0, FIRST_PAUSE_S
        until: float | None = None
        while True:
            try:
                for piece in answer.iter_raw():
                    yield piece
                    come, until, pause = come + len(piece), None, FIRST_PAUSE_S
                return
            except httpx.TransportError as error:
                broken = Unreachable(self.url, reason(error))
                broken.__cause__ = error
            finally:
                answer.close()
            until = self._clock() + self._patience if until is None else until
            if not in_parts or self._clock() + pause > until:
                raise broken
            self._sleep(pause)
            pause = min(LONGEST_PAUSE_S, pause * 2)
            part = {"range": f"bytes={come}-", "if-range": tag}
            answer = self.send("GET", path, stream=True, headers=headers | part)
            if not answer.headers.get("content-range", "").startswith(f"bytes {come}-"):
                answer.close()
                raise broken

    def events(self, model: type[Answer], path: str, silence: float) -> Iterator[Answer | None]:
        """The data of server-sent events, each validated as `model`, and None for each sign of life between them.

        None at all where the address answers with something else.

        Parameters
        ----------
        silence : float
            Seconds without anything after which the connection counts as lost.

        Raises
        ------
        RevisitProblem, Unreachable
        """
        try:
            with self._http.stream("GET", path, timeout=httpx.Timeout(silence, connect=min(5.0, silence))) as answer:
                if answer.status_code >= 300:
                    answer.read()
                    raise RevisitProblem(problem_of(answer), retry_after(answer))
                if not answer.headers.get("content-type", "").startswith("text/event-stream"):
                    return
                for line in answer.iter_lines():
                    if line.startswith("data:"):
                        yield model.model_validate_json(line.removeprefix("data:"), extra="ignore")
                    elif line.startswith(":"):
                        yield None
        except (httpx.TransportError, httpx.DecodingError) as error:
            raise Unreachable(self.url, reason(error)) from error

    def pages(self, model: type[Page], path: str, params: dict[str, str]) -> Iterator[Page]:
        """Iterate over the pages of a list, fetched as needed."""
        while True:
            page = self.receive(model, "GET", path, params=params)
            yield page
            if page.next is None:
                return
            params = {**params, "cursor": page.next}

    def send(
        self,
        method: str,
        path: str,
        *,
        repeat: bool = True,
        accept: int | None = None,
        stream: bool = False,
        **request: Any,
    ) -> httpx.Response:
        """Send a request; repeat it within `patience` seconds while that may help.

        Parameters
        ----------
        repeat : bool
            Whether the request may be sent twice after a lost connection, because its work is then done once.
        accept : int or None
            A status of 400 or more that is returned instead of raised.
        stream : bool
            Whether the body of the answer is left to be read, and the answer to be closed, by the caller.
        **request
            Further arguments of `httpx.Client.build_request`.

        Raises
        ------
        RevisitProblem, Unreachable
        """
        deadline, pause, lost = self._clock() + self._patience, FIRST_PAUSE_S, False
        while True:
            trouble: ClientError
            try:
                answer = self._http.send(self._http.build_request(method, path, **request), stream=stream)
                if stream and answer.status_code >= 300:
                    answer.read()
            except httpx.TransportError as error:
                answered, why = False, reason(error)
                trouble = Unreachable(self.url, why)
                # Where a connection is refused, nothing was sent. When it breaks, the service may have received the
                # request already: then only requests with `repeat` are sent again.
                refused = isinstance(error, httpx.ConnectError | httpx.UnsupportedProtocol)
                again, wait = self._there if refused else repeat, pause
                lost, self._there = lost or not refused, self._there or again
            except UnicodeEncodeError as error:
                raise Unsendable(f"{error.object[:100]!r} is no Unicode, and cannot be sent") from None
            except httpx.DecodingError as error:
                raise ClientError(f"{self.url} answered something that is not revisit's: {error}") from error
            else:
                answered, why = answer.status_code not in GATEWAY, f"HTTP {answer.status_code}"
                self._there, self._missed = self._there or answered, self._missed and not answered
                if answer.status_code < 300 or answer.status_code == accept:
                    return answer
                named, problem = retry_after(answer), problem_of(answer)
                if lost and method == "DELETE" and answer.status_code == 404:
                    problem.detail += MAYBE_DELETED
                trouble = RevisitProblem(problem, named, is_replayed(answer))
                # 429 and 503 are answered before any work is done: every request may be repeated. What a gateway
                # refuses may have been done.
                away = self._there and repeat and not answered
                again = away or answer.status_code in (429, 503) or (lost and _still_runs(answer))
                lost = lost or away
                # A time that is over by a clock that is ahead must not make calls without a pause.
                wait = pause if named is None or named < FIRST_PAUSE_S else named
            if not again:
                raise trouble
            if self._clock() + wait > deadline:
                self._there = answered
                raise trouble
            if not answered and not self._missed:
                self._missed = True
                log.warning("%s does not answer (%s); it is waited for, at most %.0f s", self.url, why, self._patience)
            self._sleep(wait)
            pause = min(LONGEST_PAUSE_S, pause * 2)


def _still_runs(answer: httpx.Response) -> bool:
    """Whether a call with an Idempotency-Key is refused because the same call before, whose answer got lost, may still
    run: a refusal of the work itself is replayed the next time."""
    keyed = "idempotency-key" in answer.request.headers
    return keyed and answer.status_code == 409 and not is_replayed(answer)


def _client(*, base_url: httpx.URL, transport: httpx.BaseTransport | None, **options: Any) -> httpx.Client:
    """Connections to an address; raises ClientError for a proxy or certificates that cannot be used."""
    try:
        # A proxy that HTTP_PROXY names is for other machines: this one's own addresses would be the proxy's there.
        if transport is None and _is_of_this_machine(base_url.host):
            transport = httpx.HTTPTransport()
        return httpx.Client(base_url=base_url, transport=transport, **options)
    except (ImportError, OSError, ValueError, httpx.InvalidURL) as error:
        known = (*PROXIES, "NO_PROXY", "no_proxy", "SSL_CERT_FILE", "SSL_CERT_DIR")
        named = [name for name in known if os.environ.get(name)]
        raise ClientError(f"{', '.join(named) or 'the proxy of this system'} cannot be used: {error}") from error


def _is_of_this_machine(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _address(url: str) -> httpx.URL:
    """The address of a service; raises Unsendable for what is none."""
    try:
        address = httpx.URL(url)
        if address.scheme not in ("http", "https") or not address.host:
            raise httpx.InvalidURL("it needs http:// or https:// and a host")
    except httpx.InvalidURL as error:
        raise Unsendable(
            f"{without_password(url)!r} is no address of a service, as http://127.0.0.1:8000 is ({error})"
        ) from None
    return address


def _bearing(key: str | None) -> dict[str, str]:
    """The header that carries a key (RFC 6750, 2.1); raises Unsendable, without repeating it, for what is none."""
    key = (key or "").strip()  # a file's last line break comes along with $(cat FILE)
    if not all("!" <= letter <= "~" for letter in key):
        raise Unsendable("the key has letters that no key has; take it as `./revisit keys create` printed it")
    return {"authorization": f"Bearer {key}"} if key else {}
