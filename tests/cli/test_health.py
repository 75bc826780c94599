"""What the command line prints of a map's health."""

import json

import pytest

from app.cli.__main__ import main
from app.http.examples import MAP_HEALTH
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]


def test_findings_and_what_to_do_about_them(service: FakeService, capsys: Out) -> None:
    service.replies["GET /maps/campus/health"] = 200, MAP_HEALTH

    assert main(["health", "campus", "--code", "missing-directions", "--limit", "3"]) == 0

    told = capsys.readouterr()
    finding = MAP_HEALTH["findings"][0]
    assert told.out.splitlines() == [
        f"missing-directions: {finding['detail']}",
        f"    {finding['remedy']}",
        f"    views: {', '.join(finding['views'])}",
    ]
    assert told.err == "campus: 1 missing-directions; 1730 of 1730 views examined, 1730 compared with the others\n"
    assert service.requests[0][0] == "GET /maps/campus/health?code=missing-directions&limit=3"


def test_for_machines_and_of_a_map_that_lacks_nothing(service: FakeService, capsys: Out) -> None:
    well = {**MAP_HEALTH, "map": "default", "counts": {"gap": 0}, "findings": []}
    service.replies["GET /maps/default/health"] = 200, well
    assert main(["health", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == well
    assert main(["health"]) == 0
    assert capsys.readouterr().err.startswith("default: nothing found")
