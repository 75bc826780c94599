"""The launcher sets up once, alone, what the locks list, without CUDA, and repairs; help needs none of it.

Most tests use a fake Python that records its calls; those of pip and of the command line use a real one.
"""

import os
import re
import shutil
import stat
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from app.version import VERSION

ROOT = Path(__file__).parents[1]
FAKE = """#!/bin/sh
case $1 in
-c) case $2 in *metadata*) echo "${TORCH:-2.13.0}" ;; *) echo "$0" ;; esac ;;
-V) echo "Python 3.11.9" ;;
-P) shift; echo "ran $*" ;;
-m)
    if [ "$2" = venv ]; then
        echo "venv" >>"$NOTES"
        mkdir -p "$3/bin" && cp "$0" "$3/bin/python"
        exit
    fi
    echo "$*" >>"$NOTES"
    case "$*" in *"$BREAKS"*) [ -z "$BREAKS" ] || exit 1 ;; esac
    has=$USUAL
    case "$*" in *--extra-index-url*) has=$EXTRA ;; esac
    case "$has $*" in
    pip*/torch.txt*) exec "$REAL" "$@" --dry-run --ignore-installed ;;
    cuda*/torch.txt*) exit 1 ;;
    esac
    sleep 0.2
    ;;
esac
"""


@dataclass
class Checkout:
    """A copy of the launcher and of the files that it reads."""

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
        return [note for note in self.notes() if " install " in note]


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    folder = tmp_path / "a checkout"  # with a blank in its path
    folder.mkdir()
    for name in ("revisit", "requirements.lock", "requirements-dev.lock"):
        shutil.copy(ROOT / name, folder)
    fake = tmp_path / "python"
    fake.write_text(FAKE)
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
    environment |= {"PYTHON": str(fake), "REAL": sys.executable, "NOTES": str(tmp_path / "notes")}
    return Checkout(folder, environment | {"USUAL": "cpu", "EXTRA": "cpu", "BREAKS": ""})


def test_it_sets_up_once_and_then_only_runs(checkout: Checkout) -> None:
    first = checkout.run("version", "--json")
    noted = checkout.notes()
    second = checkout.run("version")

    assert first.stdout == "ran -m app.cli version --json\n", first.stderr
    assert [re.findall(r"/(\w+)\.txt", note) for note in checkout.installs()] == [["torch"], ["packages"]]
    assert second.stdout == "ran -m app.cli version\n"
    assert second.stderr == ""
    assert checkout.notes() == noted


def test_what_is_installed_is_what_the_lock_lists_and_brings_nothing_along(checkout: Checkout) -> None:
    checkout.run("version")

    assert len(checkout.installs()) == 2
    for option in ("--require-hashes", "--no-deps", "--no-build-isolation"):
        assert all(option in note for note in checkout.installs())


def test_several_starts_at_once_set_up_once(checkout: Checkout) -> None:
    processes = [checkout.start("version") for _ in range(3)]
    outputs = [process.communicate(timeout=60) for process in processes]

    assert [out for out, _ in outputs] == ["ran -m app.cli version\n"] * 3
    assert checkout.notes().count("venv") == 1
    assert len(checkout.installs()) == 2
    assert not (checkout.folder / ".venv.lock").exists()


def test_a_set_up_that_failed_is_begun_anew(checkout: Checkout) -> None:
    broken = checkout.run("version", BREAKS="packages.txt")
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


def test_where_no_index_has_the_cpu_build_nothing_is_installed(checkout: Checkout) -> None:
    refused = checkout.run("version", USUAL="cuda", EXTRA="cuda")

    assert refused.returncode == 1
    assert "--gpu" in refused.stderr
    assert all("--require-hashes" in note and "/torch.txt" in note for note in checkout.installs())


def test_where_the_usual_index_has_only_cuda_another_is_queried(checkout: Checkout) -> None:
    assert checkout.run("version", USUAL="cuda", EXTRA="cpu").stdout == "ran -m app.cli version\n"

    assert ["--extra-index-url" in note for note in checkout.installs()] == [False, True, False]


def test_the_usual_index_is_enough_where_it_has_the_cpu_build(checkout: Checkout) -> None:
    checkout.run("version", USUAL="cpu", EXTRA="cuda")

    assert not any("--extra-index-url" in note for note in checkout.installs())


@pytest.mark.parametrize(("arguments", "environment"), [(["--gpu"], {}), ([], {"REVISIT_GPU": "1"})])
def test_cuda_is_installed_on_request_and_serves_afterwards(
    checkout: Checkout, arguments: list[str], environment: dict[str, str]
) -> None:
    checkout.run(*arguments, "version", USUAL="cuda", EXTRA="cuda", **environment)
    packages, torch = checkout.installs()

    assert "--require-hashes" in packages
    assert re.search(r" torch==[0-9.]+$", torch)
    assert "--no-deps" not in torch
    assert checkout.run("version").stderr == ""


def test_a_cpu_build_is_not_taken_for_cuda(checkout: Checkout) -> None:
    refused = checkout.run("--gpu", "version", USUAL="cuda", TORCH="2.13.0+cpu")
    assert refused.returncode == 1
    assert "CPU build of torch, from an index or folder that PIP_EXTRA_INDEX_URL, PIP_FIND_LINKS" in refused.stderr
    assert checkout.run("--gpu", "version", USUAL="cuda").stdout == "ran -m app.cli version\n"


def test_a_slim_installation_has_no_torch_and_nothing_that_only_torch_needs(checkout: Checkout) -> None:
    kept = checkout.folder.parent / "kept.txt"
    noting = f"""#!/bin/sh
for word in "$@"; do case $word in */packages.txt) cp "$word" "{kept}" ;; esac; done
"""
    venv = checkout.folder / ".venv" / "bin"
    checkout.run("--slim", "version", USUAL="cuda", EXTRA="cuda")
    (packages,) = checkout.installs()
    assert "/torch.txt" not in packages
    (venv / "python").write_text(noting)
    (checkout.folder / ".venv" / ".revisit-stamp").unlink()
    checkout.run("--slim", "version")

    left = set(re.findall(r"^([a-z0-9-]+)==", kept.read_text(), re.MULTILINE))
    listed = set(re.findall(r"^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text(), re.MULTILINE))
    assert listed - left == {"torch", "filelock", "fsspec", "mpmath", "networkx", "setuptools", "sympy"}
    assert kept.read_text().count("--hash") >= len(left)
    assert not re.search(r"^ +--hash.*\n(?! |[a-z]|\Z)", kept.read_text(), re.MULTILINE)


def test_a_slim_installation_is_enough_for_slim_alone(checkout: Checkout) -> None:
    checkout.run("--slim", "version")
    assert checkout.run("--slim", "version").stderr == ""

    checkout.run("version")

    assert any("/torch.txt" in note for note in checkout.installs())
    assert checkout.run("--slim", "version").stderr == ""


def test_the_tests_are_not_run_without_torch(checkout: Checkout) -> None:
    refused = checkout.run("--slim", "test")

    assert (refused.returncode, "need torch" in refused.stderr) == (1, True)


@pytest.mark.parametrize("local", ["", "+cpu"], ids=["as with CUDA", "another file"])
def test_a_wheel_of_torch_that_the_lock_does_not_list_is_refused(
    checkout: Checkout, tmp_path: Path, local: str
) -> None:
    version = re.findall(r"^torch==([0-9.]+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE)[0] + local
    wheel = tmp_path / "wheels" / f"torch-{version}-py3-none-any.whl"
    wheel.parent.mkdir()
    about = f"torch-{version}.dist-info"
    with zipfile.ZipFile(wheel, "w") as file:
        file.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: torch\nVersion: {version}\n")
        file.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        file.writestr(f"{about}/RECORD", "")
    only = {"PIP_CONFIG_FILE": os.devnull, "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(wheel.parent)}

    refused = checkout.run("version", USUAL="pip", EXTRA="pip", **only)

    assert refused.returncode == 1
    assert "DO NOT MATCH THE HASHES" in refused.stderr or "No matching distribution" in refused.stderr
    assert "--gpu" in refused.stderr


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-dev.lock"])
def test_a_lock_holds_hashes_and_neither_cuda_nor_a_host(name: str) -> None:
    lines = (ROOT / name).read_text().replace(" \\\n    ", " ").splitlines()
    pins = [line for line in lines if not line.startswith("#")]

    assert pins
    for pin in pins:
        assert re.fullmatch(r"[a-z0-9-]+==[^ ]+( ; [^:]+)?( --hash=sha256:[0-9a-f]{64})+", pin)
        assert not re.match("nvidia|cuda|triton", pin)


def test_torch_is_locked_to_cpu_builds() -> None:
    pins = re.findall(r"^torch==(.*) \\$", (ROOT / "requirements.lock").read_text(), re.MULTILINE)

    assert [re.sub(r"^[0-9.]+", "", pin) for pin in pins] == [
        " ; sys_platform == 'darwin'",
        "+cpu ; sys_platform != 'darwin'",
    ]


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["help"], ["set-up", "--help"], ["--gpu", "--help"]])
def test_help_is_the_command_lines_own_and_installs_nothing(checkout: Checkout, arguments: list[str]) -> None:
    helped = with_commands(checkout).run(*arguments)

    assert helped.returncode == 0
    assert helped.stdout == command_line("--help").stdout
    assert "not set up" in helped.stderr
    assert not list(checkout.folder.glob(".venv*"))


def test_the_version_is_told_without_installing(checkout: Checkout) -> None:
    told = with_commands(checkout).run("--version")

    assert (told.returncode, told.stdout) == (0, f"revisit {VERSION}\n")
    assert not list(checkout.folder.glob(".venv*"))


def test_help_about_a_command_installs_nothing(checkout: Checkout) -> None:
    with_commands(checkout)
    helped = [checkout.run("enroll", "--help"), checkout.run("help", "enroll")]

    assert [result.stdout for result in helped] == [command_line("enroll", "--help").stdout] * 2
    assert not list(checkout.folder.glob(".venv*"))


def test_without_a_command_it_says_how_it_is_used_and_installs_nothing(checkout: Checkout) -> None:
    said = with_commands(checkout).run()

    assert said.returncode == command_line().returncode == 2
    assert said.stderr.endswith(command_line().stderr)
    assert not list(checkout.folder.glob(".venv*"))


def test_help_after_a_double_dash_is_no_request_for_help(checkout: Checkout) -> None:
    assert checkout.run("enroll", "--", "--help").stdout == "ran -m app.cli enroll -- --help\n"
    assert len(checkout.installs()) == 2


def test_once_set_up_help_comes_from_the_environment(checkout: Checkout) -> None:
    checkout.run("set-up")

    assert checkout.run("help", "enroll").stdout == "ran -m app.cli enroll --help\n"
    assert checkout.run("help", "enroll").stderr == ""


def test_help_about_the_tests_runs_none(checkout: Checkout) -> None:
    checkout.run("set-up")

    assert checkout.run("test", "--help").stdout == "ran -m app.cli test --help\n"


def with_commands(checkout: Checkout) -> Checkout:
    """A checkout with the program too, and a real Python."""
    for folder in ROOT.iterdir():
        if folder.is_dir() and not folder.name.startswith("."):
            (checkout.folder / folder.name).symlink_to(folder)
    checkout.environment["PYTHON"] = sys.executable
    return checkout


def command_line(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Output of the command line in the environment of the tests."""
    command = [sys.executable, "-m", "app.cli", *arguments]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


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
