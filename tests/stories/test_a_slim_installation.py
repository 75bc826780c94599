"""Without torch the service describes and answers as with it; what needs torch says so."""

import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.running import ROOT, RunningService

pytestmark = pytest.mark.one_database("what an installation lacks is torch")

HEADERS = {"content-type": "image/jpeg"}


@pytest.fixture
def path(tmp_path: Path) -> str:
    """A PYTHONPATH in which torch is not found."""
    (tmp_path / "slim").mkdir()
    (tmp_path / "slim" / "sitecustomize.py").write_text("import sys\nsys.modules['torch'] = None\n")
    return f"{tmp_path / 'slim'}:{ROOT}:{ROOT / 'client'}"


def answered(data: Path, **environment: str) -> list[object]:
    """Places and scores of a query."""
    with (
        RunningService(data, REVISIT_ENCODER="compact", **environment) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        for number in range(6):
            client.post(f"/enroll?place=p{number}", content=photo(number), headers=HEADERS).raise_for_status()
        answer = client.post("/query", content=photo(3), headers=HEADERS).raise_for_status().json()
        return [(match["view"]["place"], match["score"]) for match in answer["matches"]]


def test_a_slim_installation_answers_as_the_whole_one_does(tmp_path: Path, path: str) -> None:
    slim, whole = answered(tmp_path / "one", PYTHONPATH=path), answered(tmp_path / "other")

    assert slim == whole
    # The same photo: every term is 1 but verification, for which photos of 64 pixels have too few keypoints.
    assert slim[0] == ("p3", pytest.approx(2.03 / 2.43, abs=0.01))


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="what a process has loaded is read from Linux")
def test_a_service_on_a_cpu_does_not_load_torch_where_it_is_installed(tmp_path: Path) -> None:
    """It would take 1 s of each start, and 240 MB."""
    of_its_own = {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}"}
    with (
        RunningService(tmp_path, REVISIT_ENCODER="compact", **of_its_own) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        client.post("/enroll", content=photo(0), headers=HEADERS).raise_for_status()
        client.post("/query", content=photo(0), headers=HEADERS).raise_for_status()

        assert "libtorch" not in Path(f"/proc/{service.pid}/maps").read_text()


@pytest.mark.parametrize("wanted", [{"REVISIT_ENCODER": "lseg"}, {"REVISIT_DEVICE": "cuda"}])
def test_what_needs_torch_is_refused_with_what_does_not(tmp_path: Path, path: str, wanted: dict[str, str]) -> None:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
    refused = subprocess.run(
        [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data", str(tmp_path / "data")],
        env=clean | wanted | {"PYTHONPATH": path},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )

    assert refused.returncode != 0
    assert "needs torch" in refused.stderr
    assert "Traceback" not in refused.stderr
