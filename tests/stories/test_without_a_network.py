"""A service with no network but its own machine starts, describes and answers: nothing is fetched."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.stories.running import ROOT

pytestmark = pytest.mark.one_database("it is about a machine alone")

ALONE = """
import fcntl, socket, struct, sys
from pathlib import Path

with socket.socket() as any_socket:  # a new network namespace has its loopback down
    fcntl.ioctl(any_socket, 0x8914, struct.pack("16sh14x", b"lo", 0x1))
try:
    socket.create_connection(("192.0.2.1", 80), 1)
    raise SystemExit("there is a network")
except OSError:
    pass

import httpx
from tests.sample_images import photo
from tests.stories.running import RunningService

data = Path(sys.argv[1])
with RunningService(data, REVISIT_ENCODER="compact") as service, httpx.Client(base_url=service.url) as client:
    for number in range(5):
        assert client.post(f"/enroll?place=p{number}", files={"image": photo(number)}, timeout=60).status_code == 201
    answer = client.post("/query", files={"image": photo(2)}, timeout=60).json()
    assert client.get("/").status_code == 200
print(answer["matches"][0]["view"]["place"])
"""


def test_nothing_is_fetched(tmp_path: Path) -> None:
    unshare = shutil.which("unshare")
    if unshare is None or os.geteuid() != 0:
        pytest.skip("NOT TRIED WITHOUT A NETWORK: needs root and the program unshare")
    alone = subprocess.run(
        [unshare, "--net", sys.executable, "-c", ALONE, str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    if "Operation not permitted" in alone.stderr:
        pytest.skip("NOT TRIED WITHOUT A NETWORK: this machine gives no network namespace")

    assert (alone.returncode, alone.stdout) == (0, "p2\n"), alone.stderr
