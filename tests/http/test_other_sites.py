"""Pages of other sites, open in a browser beside a service without keys: they neither write to it nor read it."""

import pytest

from app.http.scopes import OPEN_PATHS
from schemas import wire
from schemas.settings import Settings
from tests.http.fakes import FakeRuntime
from tests.keys_in_memory import KeyMaker
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded

IMAGE = {"content-type": "image/jpeg"}
JPEG = encoded(drawn(64, 64), "jpeg")
SHOP = {"origin": "https://shop.example"}
OTHER_SITE = "urn:revisit:problem:other-site"


def of(settings: Settings) -> CheckedClient:
    return CheckedClient(FakeRuntime(settings=settings).app())


def enroll(client: CheckedClient, **headers: str) -> int:
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    answer = client.post("/enroll", content=JPEG, headers=IMAGE | names)
    if answer.status_code == 403:
        assert answer.json()["type"] == OTHER_SITE
    return int(answer.status_code)


@pytest.mark.parametrize(
    "sent",
    [
        {"origin": "https://shop.example", "sec_fetch_site": "cross-site"},
        {"origin": "http://localhost:5173", "sec_fetch_site": "same-site"},
        {"origin": "https://shop.example"},
        {"origin": "null"},
        {"sec_fetch_site": "cross-site"},
        {"host": "localhost:8000", "origin": "http://localhost:8001"},
    ],
)
def test_a_page_of_another_site_writes_nothing(client: CheckedClient, sent: dict[str, str]) -> None:
    assert enroll(client, **sent) == 403
    assert client.get("/views").json()["views"] == []


@pytest.mark.parametrize(
    "sent",
    [
        {},
        {"host": "localhost:8000", "origin": "http://localhost:8000", "sec_fetch_site": "same-origin"},
        {"host": "robot.local", "origin": "https://robot.local"},  # a proxy ends TLS
        {"sec_fetch_site": "none"},
    ],
)
def test_its_own_page_and_programs_write(client: CheckedClient, sent: dict[str, str]) -> None:
    assert enroll(client, **sent) == 201


def test_pages_whose_origin_is_named_write() -> None:
    for cors in ("https://shop.example", "*"):
        with of(Settings(cors=cors)) as client:
            assert enroll(client, **SHOP, sec_fetch_site="cross-site") == 201
    with of(Settings(cors="https://museum.example")) as client:
        assert enroll(client, **SHOP, sec_fetch_site="cross-site") == 403


@pytest.mark.parametrize(
    "host", ["rebound.shop.example", "rebound.shop.example:8000", "127.0.0.1.shop.example", "a.b."]
)
def test_a_name_that_anybody_may_point_here_reads_nothing(client: CheckedClient, host: str) -> None:
    for path in ("/maps", "/views", "/docs", "/metrics", "/openapi.json"):
        answer = client.get(path, headers={"host": host})
        assert (answer.status_code, answer.json()["type"]) == (403, OTHER_SITE)
        assert host.partition(":")[0] in answer.json()["detail"]
    assert enroll(client, host=host) == 403


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST:8000",
        "127.0.0.1:8000",
        "[::1]:8000",
        "192.0.2.7",
        "revisit:8000",
        "robot.local",
        "a.localhost",
    ],
)
def test_addresses_and_names_of_this_network_do(client: CheckedClient, host: str) -> None:
    assert client.get("/maps", headers={"host": host}).status_code == 200


def test_signs_of_life_answer_to_any_name(client: CheckedClient) -> None:
    for path in ("/livez", "/readyz", "/version"):
        assert path in OPEN_PATHS
        assert client.get(path, headers={"host": "shop.example"}).status_code == 200


def test_readiness_names_no_map_to_a_name_that_anybody_may_point_here(
    runtime: FakeRuntime, client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def readiness() -> wire.Readiness:
        maps = {"belfry": wire.MapReadiness(state="ok", revision=3, indexed=3)}
        return wire.Readiness(ready=True, checks={"database": "ok"}, maps=maps)

    monkeypatch.setattr(runtime.recogniser, "readiness", readiness)
    assert client.get("/readyz", headers={"host": "rebound.shop.example"}).json()["maps"] == {}
    assert set(client.get("/readyz").json()["maps"]) == {"belfry"}


def test_a_service_that_is_open_has_any_name_but_takes_no_writes_of_other_pages() -> None:
    with of(Settings(open=True)) as client:
        assert client.get("/maps", headers={"host": "places.museum.example"}).status_code == 200
        assert enroll(client, host="places.museum.example", **SHOP) == 403


def test_a_key_says_who_calls_whatever_the_page() -> None:
    keys = KeyMaker()
    bearer = keys.make("app", "admin")
    with CheckedClient(FakeRuntime(keys=keys.service).app()) as client:
        given = {"host": "places.museum.example", "authorization": f"Bearer {bearer}", "sec_fetch_site": "cross-site"}
        assert enroll(client, **SHOP, **given) == 201
