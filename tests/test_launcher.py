"""The launcher, with a Python that only notes what it is asked: sets up once, alone, without CUDA, and repairs."""

import os
import shutil
import stat
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CUDA = "[\"nvidia-cudnn-cu13; platform_system != 'Nowhere'\"]"
CPU = '["filelock", "nvidia-cudnn-cu13; platform_system == \'Nowhere\'"]'

FAKE = """#!/bin/sh
case $1 in
-c) echo "$0" ;;
-V) echo "Python 3.11.9" ;;
-) exec "$REAL" "$@" ;;
-P) shift; echo "ran $*" ;;
-m)
    if [ "$2" = venv ]; then
        echo "venv" >>"$NOTES"
        mkdir -p "$3/bin" && cp "$0" "$3/bin/python"
        exit
    fi
    echo "$*" >>"$NOTES"
    case "$*" in *"$BREAKS"*) [ -z "$BREAKS" ] || exit 1 ;; esac
    needs=$USUAL
    case "$*" in *--extra-index-url*) needs=$EXTRA ;; esac
    while [ $# -gt 0 ]; do
        [ "$1" != --report ] || printf '{"install": [{"metadata": {"requires_dist": %s}}]}' "$needs" >"$2"
        shift
    done
    sleep 0.2
    ;;
esac
"""


@dataclass
class Checkout:
    """A copy of the launcher with what it reads."""

    folder: Path
    environment: dict[str, str]

    def start(self, *arguments: str, **environment: str) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [self.folder / "revisit", *arguments],
            env=self.environment | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=60)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def notes(self) -> list[str]:
        path = Path(self.environment["NOTES"])
        return path.read_text().splitlines() if path.exists() else []

    def installs(self) -> list[str]:
        return [note for note in self.notes() if " install " in note and "--dry-run" not in note]


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    folder = tmp_path / "a checkout"  # with a blank, as in many a home
    folder.mkdir()
    for name in ("revisit", "requirements.lock", "requirements-dev.lock"):
        shutil.copy(ROOT / name, folder)
    fake = tmp_path / "python"
    fake.write_text(FAKE)
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
    environment |= {"PYTHON": str(fake), "REAL": sys.executable, "NOTES": str(tmp_path / "notes")}
    return Checkout(folder, environment | {"USUAL": CPU, "EXTRA": CPU, "BREAKS": ""})


def test_it_sets_up_once_and_then_only_runs(checkout: Checkout) -> None:
    first = checkout.run("version", "--json")
    noted = checkout.notes()
    second = checkout.run("version")

    assert first.stdout == "ran -m app.cli version --json\n", first.stderr
    assert "torch==" in checkout.installs()[-1]
    assert second.stdout == "ran -m app.cli version\n"
    assert second.stderr == ""
    assert checkout.notes() == noted


def test_what_is_installed_brings_nothing_along(checkout: Checkout) -> None:
    checkout.run("version")

    assert len(checkout.installs()) == 2
    assert all("--no-deps" in note for note in checkout.installs())


def test_several_starts_at_once_set_up_once(checkout: Checkout) -> None:
    processes = [checkout.start("version") for _ in range(3)]
    outputs = [process.communicate(timeout=60) for process in processes]

    assert [out for out, _ in outputs] == ["ran -m app.cli version\n"] * 3
    assert checkout.notes().count("venv") == 1
    assert len(checkout.installs()) == 2
    assert not (checkout.folder / ".venv.lock").exists()


def test_a_set_up_that_failed_is_begun_anew(checkout: Checkout) -> None:
    broken = checkout.run("version", BREAKS="requirements.txt")
    again = checkout.run("version")

    assert broken.returncode == 1
    assert "run the command again" in broken.stderr
    assert "interrupted" in again.stderr
    assert again.stdout == "ran -m app.cli version\n"
    assert checkout.notes().count("venv") == 2


def test_a_lock_of_a_process_that_is_gone_is_taken_over(checkout: Checkout) -> None:
    gone = subprocess.Popen(["true"])
    gone.wait()
    (checkout.folder / ".venv.lock").mkdir()
    (checkout.folder / ".venv.lock" / "pid").write_text(str(gone.pid))

    assert checkout.run("version").stdout == "ran -m app.cli version\n"


def test_other_pins_are_installed_into_the_environment_that_is_there(checkout: Checkout) -> None:
    checkout.run("version")
    with (checkout.folder / "requirements.lock").open("a") as lock:
        lock.write("another==1\n")
    checkout.run("version")

    assert checkout.notes().count("venv") == 1
    assert len(checkout.installs()) == 4


def test_a_checkout_that_was_moved_is_set_up_anew(checkout: Checkout) -> None:
    checkout.run("version")
    moved = checkout.folder.with_name("moved")
    checkout.folder.rename(moved)

    assert Checkout(moved, checkout.environment).run("version").stdout == "ran -m app.cli version\n"
    assert checkout.notes().count("venv") == 2


def test_cuda_is_never_fetched_unasked(checkout: Checkout) -> None:
    refused = checkout.run("version", USUAL=CUDA, EXTRA=CUDA)

    assert refused.returncode == 1
    assert "--gpu" in refused.stderr
    assert checkout.installs() == []


def test_where_the_usual_index_has_only_cuda_another_is_asked(checkout: Checkout) -> None:
    checkout.run("version", USUAL=CUDA, EXTRA=CPU)

    assert "--extra-index-url" in checkout.installs()[-1]


@pytest.mark.parametrize(("arguments", "environment"), [(["--gpu"], {}), ([], {"REVISIT_GPU": "1"})])
def test_cuda_is_installed_when_asked_for_and_serves_afterwards(
    checkout: Checkout, arguments: list[str], environment: dict[str, str]
) -> None:
    checkout.run(*arguments, "version", USUAL=CUDA, EXTRA=CUDA, **environment)

    assert "--no-deps" not in checkout.installs()[-1]
    assert checkout.run("version").stderr == ""


def test_it_can_be_called_by_a_link_from_another_folder(checkout: Checkout, tmp_path: Path) -> None:
    link = tmp_path / "bin" / "revisit"
    link.parent.mkdir()
    link.symlink_to("../a checkout/revisit")

    assert Checkout(link.parent, checkout.environment).run("version").stdout == "ran -m app.cli version\n"
    assert (checkout.folder / ".venv").is_dir()


def test_set_up_does_only_that(checkout: Checkout) -> None:
    assert checkout.run("set-up").stdout == ""
    assert len(checkout.installs()) == 2


def test_no_python_says_what_is_needed(checkout: Checkout) -> None:
    refused = checkout.run("version", PYTHON="no-such-python")

    assert refused.returncode == 1
    assert "Python 3.11" in refused.stderr
