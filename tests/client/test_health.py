"""The client's calls about the health of maps and their unknown places."""

import json
from collections.abc import Iterator

import pytest
from revisit_client import Revisit

from app.http.examples import MAP_HEALTH
from tests.cli.fake_service import FakeService, fake_service


@pytest.fixture
def service() -> Iterator[FakeService]:
    with fake_service() as running:
        yield running


def test_each_call_reaches_its_route_and_reads_its_answer(service: FakeService) -> None:
    listed = {"map": "m", "keep_queries": 5, "kept": 0, "examined": 0, "count": 0, "places": []}
    service.replies = {
        "GET /maps/m/health": (200, MAP_HEALTH),
        "GET /maps/m/unknown": (200, listed),
        "GET /maps/m/unknown/q1/image": (200, b"a picture"),
        "POST /maps/m/unknown/q1": (200, {"views": [], "queries": 2}),
        "DELETE /maps/m/unknown/q1": (200, {"queries": 1}),
    }
    with Revisit(service.url, patience=0) as revisit:
        assert revisit.health("m", code="gap", limit=3).findings[0].headings == [180.0, 270.0]
        assert revisit.unknown("m", limit=7).keep_queries == 5
        assert revisit.unknown_image("m", "q1") == b"a picture"
        assert revisit.name_unknown("m", "q1", "dock", position={"x": 1.0, "y": 2.0}).queries == 2
        assert revisit.dismiss_unknown("m", "q1").queries == 1
    calls, bodies = zip(*service.requests, strict=True)
    assert calls[:2] == ("GET /maps/m/health?code=gap&limit=3", "GET /maps/m/unknown?limit=7")
    assert json.loads(bodies[3]) == {"place": "dock", "position": {"x": 1.0, "y": 2.0}}


def test_proposals_are_listed_looked_at_taken_and_dismissed(service: FakeService) -> None:
    listed = {"map": "m", "keep_matches": 5, "kept": 0, "examined": 0, "count": 0, "proposals": []}
    service.replies = {
        "PATCH /maps/m": (404, {}),
        "GET /maps/m/proposals": (200, listed),
        "GET /maps/m/proposals/q1/image": (200, b"a picture"),
        "POST /maps/m/proposals/q1": (200, {"views": [], "queries": 2}),
        "DELETE /maps/m/proposals/q1": (200, {"queries": 1}),
    }
    with Revisit(service.url, patience=0) as revisit:
        with pytest.raises(Exception, match="404"):
            revisit.keep_matches("m", 50)
        assert revisit.proposals("m", limit=7).keep_matches == 5
        assert revisit.proposal_image("m", "q1") == b"a picture"
        assert revisit.accept_proposal("m", "q1", views=2, unconfirmed=True).queries == 2
        assert revisit.dismiss_proposal("m", "q1").queries == 1
    calls, bodies = zip(*service.requests, strict=True)
    assert calls[1] == "GET /maps/m/proposals?limit=7"
    assert [json.loads(bodies[n]) for n in (0, 3)] == [{"keep_matches": 50}, {"views": 2, "unconfirmed": True}]


def test_how_many_queries_are_kept_is_a_change_of_the_map(service: FakeService) -> None:
    service.replies["PATCH /maps/m"] = 404, {}
    with Revisit(service.url, patience=0) as revisit, pytest.raises(Exception, match="404"):
        revisit.keep_queries("m", 50)
    assert service.requests == [("PATCH /maps/m", b'{"keep_queries":50}')]
