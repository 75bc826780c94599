"""Enrolling and querying: the use-cases run in threads, and their results become answers."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from contextvars import copy_context
from dataclasses import replace
from functools import partial
from typing import TypeVar

from app.http import enrolment_presenters, query_presenters
from app.http.long_work import LongWork
from app.http.waiter import settled
from schemas import wire
from schemas.errors import RevisitError, StorageFailed
from schemas.records import ViewAttributes
from schemas.threads import Threads
from worker.service.caller import Caller
from worker.service.enroll import Accepted, EnrollService
from worker.service.query import QueryService
from worker.service.query_options import QueryOptions
from worker.service.settlements import Settlements

T = TypeVar("T")

SEARCHING = 8
"""Threads for queries that search, beside one for each query that may wait for the encoder."""


class Recogniser:
    """Enrols images and answers queries.

    Parameters
    ----------
    enroll : EnrollService
    query : QueryService
    settlements : Settlements
    queries : int
        Most queries that may wait for the encoder; each waits in a thread of its own.
    wait_s : float
        Seconds that an enrolment waits at most for its description, all its images together.
    tell : function
        Called with the answer to each query.
    """

    def __init__(
        self,
        enroll: EnrollService,
        query: QueryService,
        settlements: Settlements,
        queries: int,
        wait_s: float,
        tell: Callable[[wire.QueryAnswer], None] = lambda answer: None,
    ) -> None:
        self._enroll, self._query = enroll, query
        self._settlements, self._wait_s, self._tell = settlements, wait_s, tell
        self._threads = Threads(queries + SEARCHING, "revisit-query")
        self._storing = LongWork(None, "revisit-enroll")

    def drain(self) -> None:
        """Let enrolments that wait for their description answer as with ``wait=false``, now and from now on."""
        self._settlements.give_up()

    async def enroll(
        self,
        images: list[tuple[str | None, bytes]],
        map_name: str,
        attributes: ViewAttributes,
        wait: bool,
        *,
        refuse_poor: bool | None,
        exif: bool = False,
        stored: Callable[[], object] = lambda: None,
    ) -> list[wire.Enrolled | RevisitError]:
        """Keep images and describe them.

        Parameters
        ----------
        images : list of (file name or None, bytes)
            Emptied once they are stored: descriptions may be waited for, and the bytes take memory.
        map_name : str
            The map is made when there is none of this name.
        attributes : ViewAttributes
        wait : bool
            Whether to wait until the views are described, within a bound; otherwise, or where the queue says that this
            bound is too short, return once the images are durable.
        refuse_poor : bool or None
            Whether images that are dark, overexposed, covered or blurred are refused; None: as the map says.
        exif : bool
            Whether the images' EXIF says where and when they were taken, where `attributes` do not.
        stored : function
            Called once the images are stored or refused.

        Returns
        -------
        list
            For each image, in order, its view or the error. A refused image leaves nothing behind, except one without
            static cells, and one that another call was told of meanwhile, which are kept as `failed` views.
        """
        until = time.monotonic() + self._wait_s
        submit = partial(self._enroll.submit, waits=wait, refuse_poor=refuse_poor, exif=exif)
        accepted = [
            await _or_refusal(self._storing.run(submit, data, map_name, replace(attributes, filename=name)))
            for name, data in images
        ]
        images.clear()
        stored()
        return [
            one if isinstance(one, RevisitError) else await _or_refusal(self._outcome(one, wait, until))
            for one in accepted
        ]

    async def _outcome(self, accepted: Accepted, wait: bool, until: float) -> wire.Enrolled:
        view = None
        hopeless = accepted.expected_s > self._wait_s
        if wait and accepted.submitted.job_id is not None and not hopeless:
            describing = time.perf_counter()
            with suppress(StorageFailed):  # while it waits: the view is durable, and described later
                view = await settled(self._settlements, accepted.submitted.view.id, until)
            waited_ms = (time.perf_counter() - describing) * 1000
            accepted = replace(accepted, timing_ms={**accepted.timing_ms, "describe": waited_ms})
        return enrolment_presenters.enrolled(await asyncio.to_thread(self._enroll.outcome, accepted, view))

    async def query(
        self, image: bytes, *maps: str, options: QueryOptions, caller: Caller | None = None
    ) -> wire.QueryAnswer:
        """Rank the views of some maps that may show the place of an image; raises as `QueryService.query`."""
        query = partial(self._query.query, image, *maps, options=options, caller=caller)
        result = await asyncio.get_running_loop().run_in_executor(self._threads, copy_context().run, query)
        answer = query_presenters.query_answer(result)
        self._tell(answer)
        return answer


async def _or_refusal(work: Awaitable[T]) -> T | RevisitError:
    """The result of a part of a call, or the error that refuses this part alone."""
    try:
        return await work
    except RevisitError as error:
        return error
