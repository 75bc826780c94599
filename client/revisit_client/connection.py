"""Requests to a service at an address: sent, and sent again while that may help."""

from collections.abc import Callable
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from revisit_client.errors import ClientError, RevisitProblem, Unreachable, problem_of, reason, retry_after

USER_AGENT = "revisit-client"

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 8.0
"""Pauses between repetitions when the service names none: each twice the one before."""

Answer = TypeVar("Answer", bound=BaseModel)


class Connection:
    """A service at an address.

    Parameters
    ----------
    url : str
        Without a slash at its end.
    timeout : float
        Seconds that one answer may take.
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
        timeout: float,
        patience: float,
        transport: httpx.BaseTransport | None,
        sleep: Callable[[float], None],
        clock: Callable[[], float],
    ) -> None:
        self.url = url
        self._patience, self._sleep, self._clock = patience, sleep, clock
        self._http = httpx.Client(
            base_url=url,
            timeout=httpx.Timeout(timeout, connect=min(5.0, timeout)),
            transport=transport,
            headers={"user-agent": USER_AGENT},
        )

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def receive(self, model: type[Answer], method: str, path: str, **request: Any) -> Answer:
        """Send a request as `send` does, and read its answer as a model.

        Raises
        ------
        RevisitProblem, Unreachable
        ClientError
            What answers is not revisit.
        """
        answer = self.send(method, path, **request)
        try:
            # A newer service may say more than this client knows; that is no reason to fail.
            return model.model_validate(answer.json(), extra="ignore")
        except (ValidationError, ValueError) as error:
            raise ClientError(f"{self.url} answered something that is not revisit's: {error}") from error

    def send(
        self, method: str, path: str, *, repeat: bool = True, accept: int | None = None, **request: Any
    ) -> httpx.Response:
        """Send a request, and send it again while that may help and patience lasts.

        Parameters
        ----------
        repeat : bool
            Whether the request can be sent twice without doing its work twice.
        accept : int or None
            A status of 400 or more that is an answer here and no refusal.
        **request
            What `httpx.Client.request` takes.

        Raises
        ------
        RevisitProblem, Unreachable
        """
        deadline, pause = self._clock() + self._patience, FIRST_PAUSE_S
        while True:
            trouble: ClientError
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError as error:
                trouble = Unreachable(self.url, reason(error))
                # An address where nobody listens is reported at once. When a connection broke, the service may have got
                # the request already: then only what is harmless twice is sent twice.
                again, wait = repeat and not isinstance(error, httpx.ConnectError | httpx.UnsupportedProtocol), pause
            else:
                if answer.status_code < 400 or answer.status_code == accept:
                    return answer
                named = retry_after(answer)
                trouble = RevisitProblem(problem_of(answer), named)
                # A refusal for being busy comes before any work: repeating is safe whatever the request.
                again, wait = answer.status_code in (429, 503), pause if named is None else named
            if not again or self._clock() + wait > deadline:
                raise trouble
            self._sleep(wait)
            pause = min(LONGEST_PAUSE_S, pause * 2)
