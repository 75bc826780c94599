"""HEAD, trailing slashes and pages of other origins."""

import re
from urllib.parse import urljoin

import pytest

from app.http.cors import METHODS, READ, SENT
from schemas.errors import SetupError
from schemas.settings import Settings, read_settings
from tests.http.document import document
from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.keys_in_memory import KeyMaker
from tests.openapi import CheckedClient
from tests.sample_images import photo

DOCUMENT = document()
READABLE = sorted(path for path, methods in DOCUMENT["paths"].items() if "get" in methods)
MUSEUM = {"origin": "https://museum.example"}


@pytest.fixture
def view(client: CheckedClient) -> str:
    return str(client.post("/enroll", files={"image": photo()}).json()["view"]["id"])


@pytest.mark.parametrize("path", [*READABLE, "/", "/docs", "/openapi.json", "/nowhere"])
def test_head_is_get_without_the_body(client: CheckedClient, view: str, path: str) -> None:
    address = re.sub(r"\{\w+\}", "default", path.replace("{view_id}", view))
    got, head = client.get(address), client.send(client.build_request("HEAD", address))
    assert (head.status_code, head.content) == (got.status_code, b"")
    changing = (
        ("x-request-id", "content-length") if path in ("/metrics", "/readyz") or got.is_error else ("x-request-id",)
    )
    kept = [{k: v for k, v in answer.headers.items() if k not in changing} for answer in (got, head)]
    assert kept[0] == kept[1]
    assert got.content or got.status_code == 204


def test_head_of_an_address_that_takes_only_post_is_refused(client: CheckedClient) -> None:
    assert client.send(client.build_request("HEAD", "/enroll")).status_code == 405
    assert client.put("/views").headers["allow"].endswith("HEAD")


@pytest.mark.parametrize(
    ("path", "methods"),
    [
        ("/views", "DELETE, GET, HEAD"),
        ("/views/v1", "DELETE, GET, HEAD, PATCH"),
        ("/maps/m", "DELETE, GET, HEAD, PATCH, PUT"),
        ("/maps/m/unknown/u1", "DELETE, POST"),
        ("/compat/compreface/m/api/v1/recognition/subjects/hall/lift", "DELETE, PUT"),
        ("/livez", "GET, HEAD"),
        ("/", "GET, HEAD"),
    ],
)
def test_a_method_that_is_refused_is_told_all_others(client: CheckedClient, path: str, methods: str) -> None:
    """Each method has a route of its own, and the framework names that of the first alone."""
    for method in ("OPTIONS", "TRACE"):
        answer = client.request(method, path)
        assert (answer.status_code, answer.headers["allow"]) == (405, methods)


def test_no_answer_is_for_a_cache_that_others_use(client: CheckedClient, view: str) -> None:
    """Such a cache knows of Authorization that answers are one caller's, and not of X-Api-Key."""
    for path in ("/maps", "/views", f"/views/{view}", f"/views/{view}/image"):
        answer = client.get(path)
        assert (answer.status_code, answer.headers["cache-control"]) == (200, "private, no-cache"), path


@pytest.mark.parametrize("path", ["/maps", "/views", "/places", "/version", "/docs"])
def test_a_slash_at_the_end_changes_nothing(client: CheckedClient, path: str) -> None:
    plain, slashed = client.get(path), client.get(f"{path}/")
    assert (slashed.status_code, slashed.content) == (200, plain.content)


SUBJECTS = "/compat/compreface/default/api/v1/recognition/subjects"


@pytest.mark.parametrize("inside", ["/maps/default/unknown/..", f"{SUBJECTS}/.", f"{SUBJECTS}/", "/maps/default/"])
def test_what_clients_make_of_a_missing_name_deletes_nothing(
    client: CheckedClient, recogniser: FakeRecogniser, inside: str
) -> None:
    assert client.post("/enroll", files={"image": photo()}, data={"place": "hall"}).status_code == 201
    sent = urljoin("http://testserver", inside)  # as fetch and others do

    refused = client.delete(sent)

    assert (refused.status_code, refused.json()["type"]) == (404, "urn:revisit:problem:not-found")
    assert "nothing was deleted" in refused.json()["detail"]
    assert len(recogniser.kept) == 1


def test_an_image_is_sent_once_whatever_the_slash(client: CheckedClient) -> None:
    assert client.post("/enroll/?place=hall", files={"image": photo()}, follow_redirects=False).status_code == 201
    assert client.get("/maps//").status_code == 404


@pytest.fixture
def shared() -> CheckedClient:
    settings = Settings(cors="https://museum.example, http://localhost:5173", max_body_mb=2)
    return CheckedClient(FakeRuntime(settings=settings).app())


def test_no_page_of_another_origin_may_read_unless_it_is_named(client: CheckedClient, shared: CheckedClient) -> None:
    assert not [name for name in client.get("/maps", headers=MUSEUM).headers if name.startswith("access-control")]
    with shared:
        other = shared.get("/maps", headers={"origin": "https://evil.example"})
        assert "access-control-allow-origin" not in other.headers
        answer = shared.get("/maps", headers=MUSEUM)
        assert answer.headers["access-control-allow-origin"] == MUSEUM["origin"]
        assert answer.headers["vary"] == "Origin"
        assert {name.lower() for name in READ} == {
            name.strip().lower() for name in answer.headers["access-control-expose-headers"].split(",")
        }
        assert "access-control-allow-credentials" not in answer.headers
        refused = shared.get("/nowhere", headers=MUSEUM)
        assert (refused.status_code, refused.headers["access-control-allow-origin"]) == (404, MUSEUM["origin"])


def test_a_page_whose_origin_is_named_reads_failures_too() -> None:
    """A browser tells its page of an answer without these headers that there was none."""
    runtime = FakeRuntime(settings=Settings(cors=MUSEUM["origin"]))
    runtime.recogniser.fails["maps"] = RuntimeError("broken")
    with CheckedClient(runtime.app()) as client:
        answer = client.get("/maps", headers=MUSEUM)
    assert (answer.status_code, answer.headers.get("access-control-allow-origin")) == (500, MUSEUM["origin"])
    assert answer.json()["request_id"] == answer.headers["x-request-id"]


@pytest.mark.parametrize("method", METHODS)
def test_a_preflight_needs_no_key(method: str) -> None:
    keys = KeyMaker()
    keys.make("operator", "admin")
    shared = CheckedClient(FakeRuntime(settings=Settings(cors=MUSEUM["origin"]), keys=keys.service).app())
    asks = {"access-control-request-method": method, "access-control-request-headers": ", ".join(SENT).lower()}
    request = shared.build_request("OPTIONS", "/views/some", headers=MUSEUM | asks)
    with shared:
        answer = shared.send(request)
        without = shared.get("/maps", headers=MUSEUM)
    assert (without.status_code, without.headers["access-control-allow-origin"]) == (401, MUSEUM["origin"])
    assert answer.status_code == 200
    assert answer.headers["access-control-allow-origin"] == MUSEUM["origin"]
    assert method in answer.headers["access-control-allow-methods"]
    assert answer.headers["x-request-id"]


def test_a_public_page_that_is_named_may_call_into_a_private_network(shared: CheckedClient) -> None:
    """Chrome sends this with the preflights of such calls (Private Network Access): refused, there is no call."""
    asks = {**MUSEUM, "access-control-request-method": "PUT", "access-control-request-private-network": "true"}
    with shared:
        answer = shared.send(shared.build_request("OPTIONS", "/maps/hall", headers=asks))
        evil = shared.send(
            shared.build_request("OPTIONS", "/maps/hall", headers={**asks, "origin": "https://a.example"})
        )

    assert (answer.status_code, answer.headers["access-control-allow-private-network"]) == (200, "true")
    assert (evil.status_code, evil.headers.get("access-control-allow-origin")) == (403, None)


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        ({"origin": "https://evil.example"}, "REVISIT_CORS does not name the origin https://evil.example"),
        ({"access-control-request-method": "TRACE"}, "pages may not send TRACE"),
        ({"access-control-request-headers": "x-api-key, x-other"}, "pages may not send the header x-other"),
        ({"access-control-request-headers": ""}, "pages may not send this"),
    ],
)
def test_a_preflight_is_refused_by_a_problem(shared: CheckedClient, sent: dict[str, str], told: str) -> None:
    asks = {**MUSEUM, "access-control-request-method": "PUT", "x-request-id": "asked-first", **sent}
    with shared:
        answer = shared.send(shared.build_request("OPTIONS", "/maps/hall", headers=asks))

    assert (answer.status_code, answer.headers["content-type"]) == (403, "application/problem+json")
    problem = answer.json()
    assert (problem["type"], problem["detail"]) == ("urn:revisit:problem:other-site", told)
    assert problem["request_id"] == answer.headers["x-request-id"] == "asked-first"
    assert int(answer.headers["content-length"]) == len(answer.content)
    allowed = answer.headers.get("access-control-allow-origin")
    assert allowed == (None if "origin" in sent else MUSEUM["origin"])


@pytest.mark.parametrize(
    "text", ["museum.example", "https://museum.example/", "https://a/b", "https://*.example", "null"]
)
def test_what_is_no_origin_is_refused_at_the_start(text: str) -> None:
    with pytest.raises(SetupError, match=r"REVISIT_CORS.*is no origin"):
        read_settings({"REVISIT_CORS": text})
    assert read_settings({"REVISIT_CORS": "*"}).cors_origins == ("*",)


def test_the_documentation_names_the_address_under_which_it_was_opened(client: CheckedClient) -> None:
    page = client.get("/docs", headers={"host": "places.local:8123"}).text
    assert "http://places.local:8123/enroll" in page
    assert ":8000" not in page
    hostile = client.get("/docs", headers={"host": "<script>"}).text
    assert "<script>" not in hostile


def test_every_parameter_is_described() -> None:
    for path, methods in DOCUMENT["paths"].items():
        for method, operation in methods.items():
            for parameter in operation.get("parameters", []):
                assert len(parameter["description"]) > 8, f"{method} {path} {parameter['name']}"
            for media in operation.get("requestBody", {}).get("content", {}).values():
                for name, field in media["schema"].get("properties", {}).items():
                    told = field.get("description") or field.get("items", {}).get("description", "")
                    assert len(told) > 8, f"{method} {path} {name} has no description"
