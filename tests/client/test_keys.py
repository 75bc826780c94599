"""The client sends the key it is given, and tells nobody else of it."""

import httpx
import pytest
from revisit_client import Revisit, RevisitProblem


def sent(key: str | None) -> str | None:
    headers: list[str | None] = []

    def answer(request: httpx.Request) -> httpx.Response:
        headers.append(request.headers.get("authorization"))
        return httpx.Response(200, json={"maps": []})

    with Revisit("http://service", key=key, transport=httpx.MockTransport(answer)) as revisit:
        revisit.maps()
    return headers[0]


def test_the_argument_wins_over_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REVISIT_KEY", raising=False)
    assert sent(None) is None
    monkeypatch.setenv("REVISIT_KEY", "rv_variable\n")
    assert sent(None) == "Bearer rv_variable"
    assert sent("rv_argument") == "Bearer rv_argument"


def test_a_key_that_cannot_be_one_is_refused_without_repeating_it() -> None:
    with pytest.raises(ValueError, match="letters") as refusal:
        Revisit("http://service", key="geheim schlüssel")
    assert "geheim" not in str(refusal.value)


def test_a_refusal_is_not_repeated() -> None:
    calls: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        calls.append(request.url.path)
        problem = {"type": "urn:revisit:problem:unauthorized", "title": "A key is needed", "status": 401}
        return httpx.Response(401, json=problem | {"detail": "", "errors": [], "request_id": "r"})

    with (
        Revisit("http://service", transport=httpx.MockTransport(answer)) as revisit,
        pytest.raises(RevisitProblem) as refusal,
    ):
        revisit.maps()
    assert (refusal.value.code, calls) == ("unauthorized", ["/maps"])
