"""The demo runs a service of its own: whatever the shell says of another one, and however the demo ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from revisit_client import Revisit

from app.cli.__main__ import main
from app.cli.service import started
from tests.sample_images import photo
from tests.storage.object_store import ObjectStore
from tests.stories.running import ROOT
from tests.waiting import until

pytestmark = pytest.mark.one_database("the demo has a database of its own, in a folder that it removes")

WAITS = """
import signal, sys
from pathlib import Path
from app.cli.service import started

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # whoever runs the tests may be told to ignore it, by nohup
with started(Path(sys.argv[1]) / "data", Path(sys.argv[1]) / "log") as service:
    print(service.process.pid, flush=True)
    signal.pause()
"""


def is_there(pid: int) -> bool:
    """Whether a process runs, and is not one that has ended and nobody asked about."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM])
def test_a_closed_terminal_leaves_no_service_behind(tmp_path: Path, number: signal.Signals) -> None:
    env = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'client'}", "REVISIT_ENCODER": "color"}
    with subprocess.Popen([sys.executable, "-c", WAITS, tmp_path], env=env, stdout=subprocess.PIPE, text=True) as demo:
        assert demo.stdout is not None
        service = int(demo.stdout.readline())
        assert is_there(service)
        demo.send_signal(number)
        assert demo.wait(60) == 128 + number
    until(lambda: not is_there(service))


def test_the_images_of_the_fleet_that_a_shell_is_set_up_for_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service on a new database would take them for what a crash left, and remove them all."""
    objects = ObjectStore()
    digest = "ab12" + "0" * 60
    objects.client.put_object(Bucket="places", Key=f"museum/images/ab/12/{digest}", Body=b"of the fleet")
    before = objects.names()
    of_the_fleet = {**objects.environment, "REVISIT_INLINE_WORKER": "false", "REVISIT_LIMIT_REQUESTS": "1"}
    for name, value in {**of_the_fleet, "REVISIT_ENCODER": "color"}.items():
        monkeypatch.setenv(name, value)

    with started(tmp_path / "data", tmp_path / "log") as service, Revisit(service.url(), patience=0) as revisit:
        assert revisit.enroll(photo(1), place="gate").view.state == "ready"
        assert revisit.query(photo(1)).matches[0].view.place == "gate"

    assert objects.names() == before


def test_a_photo_of_ones_own_that_cannot_be_read_is_named_and_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("REVISIT_ENCODER", "color")
    photos = tmp_path / "photos"
    photos.mkdir()
    for number in range(4):
        (photos / f"{number}.jpg").write_bytes(photo(number))
    (photos / "broken.jpg").write_bytes(photo(5)[:200])
    (photos / "notes.heic").write_text("no image")

    main(["demo", "--photos", str(photos), "--output", str(tmp_path / "out")])

    out, err = capsys.readouterr()
    for name in ("broken.jpg", "notes.heic"):
        assert f"left out: {photos / name}: " in err
    assert "of 4 known places were recognised" in out
    assert "the service ends now; with --keep it stays" in out
