"""Whether enrolled images find themselves, as `revisit doctor` asks."""

import pytest
from revisit_client import Revisit

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
