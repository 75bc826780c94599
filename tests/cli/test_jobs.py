"""What the command line says of work in the background."""

import json

import pytest

from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]
ONE = f"/jobs/{answers.JOB}"


def test_jobs_are_listed_newest_first_with_what_became_of_them(service: FakeService, capsys: Out) -> None:
    failed = answers.job("failed", kind="vocabulary", failure={"code": "conflict", "detail": "too few views"})
    running = answers.job("running", kind="import", progress={"done": 3, "total": 40})
    service.replies["GET /jobs"] = 200, {"jobs": [running, failed], "next": None}

    assert main(["jobs", "--map", "campus", "--kind", "import", "--state", "running"]) == 0

    rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
    assert rows[0][:7] == [answers.JOB, "import", "default", "running", "3", "of", "40"]
    assert rows[1][:5] == [answers.JOB, "vocabulary", "default", "failed:", "conflict"]
    assert service.requests[0][0] == "GET /jobs?map=campus&kind=import&state=running"
    assert main(["jobs", "--limit", "1", "--json"]) == 0
    assert [job["kind"] for job in json.loads(capsys.readouterr().out)] == ["import"]


def test_a_job_is_shown_followed_and_cancelled(service: FakeService, capsys: Out) -> None:
    states = iter([answers.job("running", kind="import", progress={"done": n, "total": 2}) for n in (0, 1)])
    done = answers.job("done", kind="import", progress={"done": 2, "total": 2}, result={"enrolled": 2})
    service.replies[f"GET {ONE}"] = lambda _: (200, next(states, done))
    service.replies[f"DELETE {ONE}"] = 200, answers.job("cancelled")

    assert main(["jobs", answers.JOB, "--follow"]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["result"] == {"enrolled": 2}
    assert told.err.splitlines() == ["1/2 import of map default", "2/2 import of map default"]
    assert main(["jobs", answers.JOB]) == 0
    assert json.loads(capsys.readouterr().out)["state"] == "done"
    assert main(["jobs", answers.JOB, "--cancel"]) == 0
    assert json.loads(capsys.readouterr().out)["state"] == "cancelled"


def test_a_job_that_fails_while_it_is_followed_says_why(service: FakeService, capsys: Out) -> None:
    failed = answers.job("failed", kind="vocabulary", failure={"code": "conflict", "detail": "too few views"})
    service.replies[f"GET {ONE}"] = 200, failed
    assert main(["jobs", answers.JOB, "--follow"]) == 1
    assert "too few views" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wrong", [["--follow"], ["--cancel"], ["j", "--follow", "--cancel"], ["j", "--map", "campus"], ["--limit", "0"]]
)
def test_wrong_use_is_told_before_anything_is_sent(service: FakeService, wrong: list[str]) -> None:
    try:
        code = main(["jobs", *wrong])
    except SystemExit as refused:
        code = int(str(refused.code))
    assert code == 2
    assert service.requests == []
