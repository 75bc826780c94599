"""The encoder of a worker fails on every image, as on a GPU that is lost: it ends, and no photo is given up for it."""

import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.running import ROOT, RunningService, variables, worker
from tests.waiting import until

pytestmark = pytest.mark.one_database("what a worker does with its images is the same on both")

ILL = """
import sys
import worker
import app.cli.serve, worker.description.blame, worker.description.scheduler
from app.cli.__main__ import main
from worker.encoders.color import ColorEncoder

def encode(self, images, *, urgent=False):
    raise RuntimeError("CUDA error: an illegal memory access was encountered")

ColorEncoder.encode = encode
app.cli.serve.LOOK_EVERY_S = 0.1
worker.description.blame.REST_S = 0
worker.description.scheduler.HOPELESS_S = 0.5
sys.exit(main(["worker"]))
"""


def test_a_worker_that_fails_on_every_image_ends_and_another_describes_them(tmp_path: Path) -> None:
    with (
        RunningService(tmp_path, False, REVISIT_INLINE_WORKER="false") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):

        def views() -> dict[str, int]:
            counts: dict[str, int] = client.get("/maps/quay").json()["views"]
            return counts

        for number in range(3):
            where = f"/enroll?map=quay&place=spot-{number}&wait=0"
            taken = client.post(where, content=photo(number), headers={"content-type": "image/jpeg"})
            assert taken.status_code == 202

        ill = subprocess.run(
            [sys.executable, "-c", ILL],
            env=variables(tmp_path),
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

        assert ill.returncode == 1, ill.stderr
        assert "illegal memory access" in ill.stderr
        assert "stopped, so that it is started anew: the encoder has failed on every image for" in ill.stderr
        assert views() == {"pending": 3, "ready": 0, "failed": 0}
        with worker(tmp_path):
            until(lambda: views()["ready"] == 3)
