"""docs/operations.md, "Three machines": its commands and settings, each machine as processes with their own folder."""

import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.storage.databases import postgres_schema
from tests.storage.object_store import ObjectStore
from tests.stories.fleets import JPEG, until
from tests.stories.importing import ZIP, ended, photos, zipped
from tests.stories.running import ROOT, RunningService, worker
from tests.stories.test_behind_nginx import free_port, nginx

pytestmark = pytest.mark.one_database("it has databases of its own")

PAGE = (ROOT / "docs" / "operations.md").read_text()
BALANCER = (ROOT / "deploy" / "fleet" / "nginx.conf").read_text()


def section(title: str) -> str:
    return PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def commands(title: str) -> list[list[str]]:
    return [line.split() for line in re.findall(r"^ +\./revisit (.+)$", section(title), re.MULTILINE)]


def said(there: dict[str, str], data: Path, command: list[str]) -> str:
    """What a command prints."""
    path = f"{ROOT}:{ROOT / 'client'}"
    ours = {"PATH": "/usr/bin:/bin", "PYTHONPATH": path, "REVISIT_DATA": str(data)}
    program = [sys.executable, "-m", "app.cli", *command]
    done = subprocess.run(program, cwd=ROOT, env=ours | there, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_one_machine_has_the_same_two_commands() -> None:
    assert commands("One machine") == [
        ["keys", "create", "operator", "--scope", "admin"],
        ["serve", "--host", "0.0.0.0"],
    ]


def test_three_machines_serve_and_one_of_them_may_be_away(tmp_path: Path) -> None:
    migrate, create, serve, work = commands("Three machines")
    assert (migrate, serve, work) == (["migrate"], ["serve"], ["worker"])
    objects = ObjectStore()
    with postgres_schema() as url, ExitStack() as stack:
        stack.callback(objects.stop)
        there = {"REVISIT_DATABASE": url, "REVISIT_INLINE_WORKER": "false", "REVISIT_HOST": "0.0.0.0"}
        there |= objects.environment
        named = re.findall(r"^ +((?:REVISIT|AWS)_\w+)=", section("Three machines"), re.MULTILINE)
        assert set(named) - {"REVISIT_DATA"} <= set(there), "a setting of the page that is not tried here"
        there = {name: value for name, value in there.items() if name in named or name.startswith("AWS_")}

        said(there, tmp_path / "machine-1", migrate)
        [key] = re.findall(r"\brv_\w+", said(there, tmp_path / "machine-1", create))
        quick = there | {"REVISIT_LEASE_S": "2"}
        machines = [
            (stack.enter_context(RunningService(tmp_path / name, False, **quick)),
             stack.enter_context(worker(tmp_path / name, **quick)))
            for name in ("machine-2", "machine-3")
        ]  # fmt: skip
        conf = BALANCER
        port = free_port()
        for node, (service, _) in zip(("node-a", "node-b"), machines, strict=True):
            conf = conf.replace(f"{node}:8000", service.url.removeprefix("http://"))
        address = stack.enter_context(
            nginx(tmp_path / "nginx", conf.replace("listen 8000;", f"listen 127.0.0.1:{port};"), port)
        )
        headers = {"authorization": f"Bearer {key}"}
        client = stack.enter_context(httpx.Client(base_url=address, headers=headers, timeout=90))
        until(client)
        assert httpx.post(f"{address}/query", content=photo(1), headers=JPEG, timeout=60).status_code == 401
        view = client.post("/enroll", content=photo(1), headers=JPEG).json()["view"]["id"]
        job = client.post("/maps/walk/imports", content=zipped(photos(20)), headers=ZIP).json()["id"]
        assert ended(client, job)["result"]["enrolled"] == 20

        service, process = machines[1]
        process.send_signal(signal.SIGKILL)
        service.kill()
        began = time.monotonic()
        for number in range(4):
            while True:  # nginx passes a POST on only where it did not reach the node
                answer = client.post("/query", content=photo(1), headers=JPEG)
                if answer.status_code == 200:
                    break
                assert answer.status_code == 503
                assert time.monotonic() - began < 20
            assert answer.json()["matches"][0]["view"]["id"] == view
            assert client.post("/enroll", content=photo(10 + number), headers=JPEG).status_code == 201
        snapshot = ended(client, client.post("/maps/walk/snapshots").json()["id"])
        assert client.get(f"/snapshots/{snapshot['id']}").status_code == 200
