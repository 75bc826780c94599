"""Whether enrolled images find themselves, as `revisit doctor` asks."""

import json
from pathlib import Path

import pytest
from revisit_client import Revisit

from app.cli.__main__ import main
from app.cli.auditing import audit
from tests import answers
from tests.cli.fake_service import FakeService


@pytest.mark.parametrize("code", ["image-not-kept", "not-found"])
def test_a_view_whose_image_is_not_kept_or_that_went_meanwhile_is_no_finding(service: FakeService, code: str) -> None:
    view = answers.view()
    service.replies["GET /views"] = 200, {"views": [view], "next": None}
    service.replies[f"GET /views/{view['id']}/image"] = 404, answers.problem(code, 404)
    with Revisit() as revisit:
        assert audit(revisit, "campus", every=True, quiet=True) == {"queried": 0, "found": 0, "findings": []}

    service.replies[f"GET /views/{view['id']}/image"] = 500, answers.problem("damaged", 500)
    with Revisit() as revisit:
        found = audit(revisit, "campus", every=True, quiet=True)
    assert (found["queried"], found["found"], len(found["findings"])) == (1, 0, 1)


def test_doctor_examines_the_service_that_its_own_variables_are_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a container or a unit with another port there is no REVISIT_URL."""
    monkeypatch.delenv("REVISIT_URL", raising=False)
    monkeypatch.setenv("REVISIT_HOST", "0.0.0.0")
    monkeypatch.setenv("REVISIT_PORT", "9")
    main(["doctor", "--data", str(tmp_path), "--json"])
    assert json.loads(capsys.readouterr().out)["service"]["url"] == "http://127.0.0.1:9"
