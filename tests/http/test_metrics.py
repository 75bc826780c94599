"""What `/metrics` prints: names, labels that stay few, and an answer in time whatever the database does."""

import asyncio
import gc
import re
import threading

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from app.http.encoding import encoder_application
from app.http.problems import KINDS
from app.http.statistics import MAPS, OTHER, PATIENCE_S, StatisticsCollector, StatisticsReader
from schemas.settings import read_settings
from schemas.statistics import IndexLag, MapStatistics, ServiceStatistics, StoreStatistics
from tests import waiting
from tests.http.fakes import FakeRecogniser
from tests.openapi import CheckedClient
from tests.sample_images import photo
from worker.encoders.color import ColorEncoder
from worker.service.encoding import EncodingService

JPEG = {"content-type": "image/jpeg"}


def samples(text: str) -> dict[str, dict[tuple[tuple[str, str], ...], float]]:
    """Values by name and labels."""
    found: dict[str, dict[tuple[tuple[str, str], ...], float]] = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            found.setdefault(sample.name, {})[tuple(sorted(sample.labels.items()))] = sample.value
    return found


def test_names_begin_with_the_service_and_end_with_base_units(client: CheckedClient) -> None:
    for family in text_string_to_metric_families(client.get("/metrics").text):
        assert re.match(r"(revisit|process|python)_[a-z_]+$", family.name), family.name
        assert not re.search(r"_(ms|milliseconds|mb|kb|percent)(_|$)", family.name), family.name
        assert family.documentation


def test_a_query_counts_its_verdict_and_its_bytes(client: CheckedClient) -> None:
    client.post("/enroll?map=m", content=photo(), headers=JPEG)
    answer = client.post("/query?map=m", content=photo(), headers=JPEG)
    found = samples(client.get("/metrics").text)
    body = answer.json()
    verdict = (("reason", body["reason"]["code"]), ("status", body["status"]))
    assert found["revisit_query_verdicts_total"] == {verdict: 1}
    query = (("method", "POST"), ("route", "/query"))
    assert found["revisit_http_request_bytes_total"][query] == len(photo())
    assert found["revisit_http_response_bytes_total"][query] == len(answer.content)
    assert found["revisit_http_requests_in_flight"] == {(): 1}  # this one


def test_a_shared_encoder_says_its_state() -> None:
    """Where it is watched as nodes are, the alert of those that do not become ready looks at it too."""
    made = encoder_application(lambda told: EncodingService(ColorEncoder(), 4, told, 8, None), read_settings({}))
    with TestClient(made) as client:
        ready = samples(client.get("/metrics").text)["revisit_state"]
        made.state.shared.drain()
        draining = samples(client.get("/metrics").text)["revisit_state"]
    assert [state for found in (ready, draining) for ((_, state),), value in found.items() if value] == [
        "ready",
        "draining",
    ]


def test_errors_are_counted_by_type_and_limits_by_reason(client: CheckedClient) -> None:
    client.get("/views/nothing-of-the-kind")
    client.post("/enroll", content=b"x" * 2_000_001, headers=JPEG)
    found = samples(client.get("/metrics").text)
    types = {dict(labels)["type"]: value for labels, value in found["revisit_http_problems_total"].items()}
    assert types == {"not-found": 1, "body-too-large": 1}
    assert types.keys() <= KINDS.keys()
    assert found["revisit_rejected_total"] == {(("reason", "body-bytes"),): 1}


def test_an_error_of_one_of_several_images_is_counted(client: CheckedClient) -> None:
    files = [("image", ("a.jpg", photo(), "image/jpeg")), ("image", ("b.jpg", b"no image at all", "image/jpeg"))]
    assert client.post("/enroll", files=files).status_code == 207
    found = samples(client.get("/metrics").text)
    assert found["revisit_http_problems_total"] == {(("type", "not-a-picture"),): 1}


def test_no_label_holds_an_id_or_a_callers_words(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    client.post("/enroll?place=hall", content=photo(), headers=JPEG | {"x-request-id": "callers-own"})
    view = next(iter(recogniser.kept))
    client.get(f"/views/{view}")
    client.request("PROPFIND", "/somewhere/else")
    text = client.get("/metrics").text
    for secret in (view, "callers-own", "hall", "PROPFIND", "somewhere"):
        assert secret not in text


def many(count: int) -> ServiceStatistics:
    maps = tuple(MapStatistics(f"m{i}", i + 1, {"ready": i, "failed": 1}, 10, 2) for i in range(count))
    return ServiceStatistics(StoreStatistics(maps, (), 1), {"m0": IndexLag(3, 4)})


def test_many_maps_share_series_and_nothing_is_lost_in_the_sum() -> None:
    collector = StatisticsCollector()
    collector.statistics = many(MAPS + 30)
    views = next(family for family in collector.collect() if family.name == "revisit_views")
    assert len({sample.labels["map"] for sample in views.samples}) == MAPS + 1
    assert sum(s.value for s in views.samples if s.labels["state"] == "ready") == sum(range(MAPS + 30))
    assert OTHER in {sample.labels["map"] for sample in views.samples}
    few = StatisticsCollector()
    few.statistics = many(2)
    assert OTHER not in {s.labels.get("map") for family in few.collect() for s in family.samples}


def test_statistics_that_hang_leave_the_last_ones_and_never_the_caller() -> None:
    release, gathered = threading.Event(), many(1)
    hanging = threading.Event()

    def gather() -> ServiceStatistics:
        if hanging.is_set():
            release.wait(2 * waiting.PATIENCE_S)
        return gathered

    async def story() -> None:
        reader = StatisticsReader(gather)
        first, _ = await reader.read()
        assert first is gathered
        hanging.set()
        reader._due_at = 0  # as if it were time to gather again
        began = asyncio.get_running_loop().time()
        again, age = await reader.read()
        assert again is gathered
        assert age >= PATIENCE_S * 0.9
        assert asyncio.get_running_loop().time() - began < waiting.PATIENCE_S
        release.set()
        reader.close()

    asyncio.run(story())


def test_statistics_that_were_never_gathered_age_from_the_first_call_on() -> None:
    """As with a database that is damaged, or takes minutes: the alert of old figures goes by their age."""

    def gather() -> ServiceStatistics:
        raise OSError("the disk is gone")

    async def story() -> None:
        reader, collector = StatisticsReader(gather), StatisticsCollector()
        assert _ages(collector) == []
        collector.statistics, first = await reader.read()
        await asyncio.sleep(0.05)
        collector.statistics, collector.age_s = await reader.read()
        assert collector.statistics is None
        assert [first + 0.05 <= age < waiting.PATIENCE_S for age in _ages(collector)] == [True]
        reader.close()

    asyncio.run(story())


def _ages(collector: StatisticsCollector) -> list[float]:
    [age] = [family for family in collector.collect() if family.name == "revisit_statistics_age_seconds"]
    return [sample.value for sample in age.samples]


def test_statistics_that_fail_leave_the_last_ones_and_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    answers: list[ServiceStatistics | Exception] = [many(1), OSError("the disk is gone"), many(2)]

    def gather() -> ServiceStatistics:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def story() -> None:
        reader = StatisticsReader(gather)
        seen = []
        for _ in range(3):
            reader._due_at = 0
            known, _ = await reader.read()
            assert known is not None
            seen.append(len(known.store.maps))
        reader.close()
        assert seen == [1, 1, 2]

    asyncio.run(story())
    gc.collect()  # asyncio logs with a traceback what nobody has taken
    assert [record.getMessage() for record in caplog.records if record.name in ("revisit.http", "asyncio")] == [
        "the gauges are not gathered: OSError"
    ]
