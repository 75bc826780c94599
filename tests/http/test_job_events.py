"""`GET /jobs/{id}/events`: a job as it changes."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from app.http.job_events import KEEP_ALIVE_S, LOOK_S, MOST_FOLLOWERS, Followers, job_events
from schemas import wire
from schemas.errors import NotFound
from tests import answers
from tests.http.fakes import FakeRuntime
from tests.openapi import CheckedClient


def state(**changes: Any) -> wire.Job:
    return wire.Job.model_validate(answers.job(**changes))


class Looks:
    """A job that is another at each look; the last stays. What is an error is raised."""

    def __init__(self, *jobs: wire.Job | Exception) -> None:
        self.jobs = list(jobs)

    async def __call__(self) -> wire.Job:
        job = self.jobs.pop(0) if len(self.jobs) > 1 else self.jobs[0]
        if isinstance(job, Exception):
            raise job
        return job


def events(job: wire.Job, looks: Looks, stopping: Callable[[], bool] = lambda: False) -> tuple[list[str], float]:
    """What is sent, and seconds that it took."""
    naps: list[float] = []

    async def sleep(seconds: float) -> None:
        naps.append(seconds)

    async def all_of() -> list[str]:
        return [part.decode() async for part in job_events(job, looks, stopping, Followers(), sleep=sleep)]

    return asyncio.run(all_of()), sum(naps)


def told(parts: list[str]) -> list[wire.Job]:
    """The jobs of events, comments left out."""
    data = [line for part in parts for line in part.splitlines() if line.startswith("data: ")]
    return [wire.Job.model_validate_json(line.removeprefix("data: ")) for line in data]


def test_each_change_is_sent_once_and_the_end_is_the_last() -> None:
    waiting, done = state(state="waiting"), state(state="done")
    half, same = (state(state="running", progress={"done": 1, "total": 2}) for _ in range(2))

    parts, seconds = events(waiting, Looks(waiting, half, same, done))

    assert told(parts) == [waiting, half, done]
    assert all(part.startswith("event: job\n") and part.endswith("\n\n") for part in parts)
    assert seconds == 4 * LOOK_S


@pytest.mark.parametrize("end", ["done", "failed", "cancelled"])
def test_of_a_job_that_has_ended_its_end_is_sent(end: str) -> None:
    parts, seconds = events(state(state=end), Looks(AssertionError("no need to look")))

    assert (told(parts), seconds) == ([state(state=end)], 0)


def test_while_nothing_changes_there_are_signs_of_life() -> None:
    running = state(state="running")
    silent = [running] * round(2 * KEEP_ALIVE_S / LOOK_S)

    parts, _ = events(running, Looks(*silent, state(state="done")))

    assert [part[0] for part in parts] == ["e", ":", ":", "e"]


def test_events_end_when_the_job_is_gone() -> None:
    running = state(state="running")

    parts, _ = events(running, Looks(running, NotFound("job", running.id)))

    assert told(parts) == [running]


def test_events_end_when_the_service_stops() -> None:
    running = state(state="running")
    stops = iter([False, False, True])

    parts, seconds = events(running, Looks(running), lambda: next(stops))

    assert (told(parts), seconds) == ([running], 2 * LOOK_S)


def test_who_is_one_too_many_is_told_the_present_state_and_to_come_again_later() -> None:
    """Each follower looks up its job and its key four times a second: hundreds would leave no time for images."""
    running, done = state(state="running"), state(state="done")
    followers, ends = Followers(2), asyncio.Event()

    async def sleep(seconds: float) -> None:
        await ends.wait()

    async def follow(looks: Looks) -> list[str]:
        return [part.decode() async for part in job_events(running, looks, lambda: False, followers, sleep=sleep)]

    async def three() -> list[list[str]]:
        patient = [asyncio.create_task(follow(Looks(done))) for _ in range(2)]
        await asyncio.sleep(0)
        one_too_many = await follow(Looks(AssertionError("no look")))
        ends.set()
        return [one_too_many, *await asyncio.gather(*patient), await follow(Looks(done))]

    crowded, *others = asyncio.run(three())

    assert (told(crowded), "retry: 5000" in crowded[0]) == ([running], True)
    assert [told(parts) for parts in others] == [[running, done]] * 3
    assert MOST_FOLLOWERS < 512, "of the connections that are served at once some are left for others"


def test_who_goes_away_is_no_follower_any_more(client: CheckedClient, runtime: FakeRuntime) -> None:
    runtime.recogniser.job_states = ["running"]

    for _ in range(MOST_FOLLOWERS + 5):
        answer = client.send(client.build_request("HEAD", "/jobs/j9/events"))
        assert answer.status_code == 200
    runtime.recogniser.job_states = ["running", "done"]
    with client.stream("GET", "/jobs/j9/events") as events:
        events.read()

    assert [job.state for job in told([events.text])] == ["running", "done"]


def test_events_over_http(client: CheckedClient, runtime: FakeRuntime) -> None:
    runtime.recogniser.job_states = ["waiting", "running", "done"]

    with client.stream("GET", "/jobs/j9/events") as answer:
        answer.read()

    assert answer.headers["content-type"].startswith("text/event-stream")
    assert answer.headers["x-accel-buffering"] == "no"
    assert [job.state for job in told([answer.text])] == ["waiting", "running", "done"]
    assert {job.id for job in told([answer.text])} == {"j9"}


def test_head_of_events_does_not_wait_for_the_job(client: CheckedClient, runtime: FakeRuntime) -> None:
    runtime.recogniser.job_states = ["running"]

    answer = client.send(client.build_request("HEAD", "/jobs/j9/events"))

    assert (answer.status_code, answer.content) == (200, b"")


def test_a_job_that_there_is_not_has_no_events(client: CheckedClient) -> None:
    answer = client.get("/jobs/gone/events")

    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_how_long_a_job_takes_is_not_how_long_the_service_took_to_answer(
    client: CheckedClient, runtime: FakeRuntime, caplog: pytest.LogCaptureFixture
) -> None:
    looks = 12
    runtime.recogniser.job_states = ["running"] * looks + ["done"]

    with caplog.at_level("INFO", "revisit.access"):
        client.get("/jobs/j9/events")

    (record,) = [r for r in caplog.records if getattr(r, "route", "") == "/jobs/{job_id}/events"]
    assert record.__dict__["ms"] < looks / 2 * LOOK_S * 1000
