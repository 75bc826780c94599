"""Wrong use is exit code 2, failure 1, and each says what to do next; nothing slow is imported to say so."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from app.cli import browse
from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["unheard-of"],
        ["enroll"],
        ["query"],
        ["vocabulary"],
        ["serve", "--port", "many"],
        ["query", "a.jpg", "--top", "five"],
        ["query", "a.jpg", "--top", "1_0"],
        ["query", "a.jpg", "--drive-timeout", "12_5"],
        ["loops", "a.jpg", "--map", "m", "--positions", "p.csv", "--radius", "nan"],
        ["calibrate", "labels.csv", "--map", "m", "--within", "inf"],
    ],
)
def test_wrong_use_is_2(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(argv)

    assert caught.value.code == 2
    assert "usage:" in capsys.readouterr().err


@pytest.mark.usefixtures("nobody")
@pytest.mark.parametrize("argv", [["maps"], ["views"], ["places"], ["healthcheck"], ["recipe"], ["openapi"]])
def test_a_service_that_does_not_run_is_1_and_says_how_to_start_one(
    argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(argv) == 1
    assert "./revisit serve" in capsys.readouterr().err


def test_a_refusal_is_1_and_says_what_the_service_said(
    service: FakeService, capsys: pytest.CaptureFixture[str]
) -> None:
    service.replies["GET /maps/x"] = 404, answers.problem()

    assert main(["maps", "x"]) == 1
    assert "there is no map 'x'" in capsys.readouterr().err


def test_where_a_key_is_needed_the_command_line_says_how_it_is_given(
    service: FakeService, capsys: pytest.CaptureFixture[str]
) -> None:
    service.replies["GET /maps"] = 401, answers.problem("unauthorized", 401)

    assert main(["maps"]) == 1
    assert "takes the key from REVISIT_KEY, or from --key" in capsys.readouterr().err


def test_tests_need_a_checkout(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test"]) == 2
    assert "checkout" in capsys.readouterr().err


def test_a_mistake_of_ours_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: object) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(browse, "run_places", broken)

    with pytest.raises(ZeroDivisionError):
        main(["places"])


def test_whoever_interrupts_while_the_commands_are_loaded_gets_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib, "import_module", interrupted)

    assert main(["places"]) == 130
    assert capsys.readouterr().err == "revisit: interrupted\n"


def test_help_loads_nothing_slow() -> None:
    script = (
        "import sys\n"
        "from app.cli.__main__ import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "main(['version'])\n"
        "import json; print(json.dumps([m for m in ('torch', 'cv2', 'faiss', 'fastapi', 'httpx', 'numpy', 'pydantic',"
        " 'sqlalchemy') if m in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)

    assert json.loads(done.stdout.splitlines()[-1]) == []


@pytest.mark.parametrize("argv", [["query"], ["views"], ["keys", "revoke"], ["vocabulary", "train"], ["test"]])
def test_the_help_of_a_command_begins_with_what_it_is_for(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*argv, "--help"])
    usage, what_for, *_ = capsys.readouterr().out.split("\n\n")
    assert usage.startswith(f"usage: revisit {' '.join(argv)}")
    assert what_for.endswith(".")


def test_version_as_text_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["version"]) == 0
    text = capsys.readouterr().out
    assert main(["version", "--json"]) == 0

    assert text == f"revisit {json.loads(capsys.readouterr().out)['version']}\n"


@pytest.mark.parametrize(("ready", "code"), [(True, 0), (False, 1)])
def test_the_healthcheck_tells_by_its_exit_code(
    service: FakeService, capsys: pytest.CaptureFixture[str], ready: bool, code: int
) -> None:
    checks = {"encoder": "ok" if ready else "loading"}
    service.replies["GET /readyz"] = 200 if ready else 503, {"ready": ready, "checks": checks}

    assert main(["healthcheck"]) == code
    if not ready:
        assert "encoder: loading" in capsys.readouterr().err


def test_a_folder_without_a_database_is_not_migrated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "dta"
    assert main(["migrate", "--data", str(folder)]) == 1
    assert (capsys.readouterr().err, folder.exists()) == (
        f"revisit: {folder} has no database of a service: --data or REVISIT_DATA names its data folder; "
        "`serve` begins a new one\n",
        False,
    )


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("127.0.0.2", "http://127.0.0.2:9"),
        ("0.0.0.0", "http://127.0.0.1:9"),
        ("::1", "http://[::1]:9"),
        ("", "http://127.0.0.1:9"),
    ],
)
def test_the_healthcheck_looks_where_the_service_listens(
    host: str, url: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("REVISIT_URL", raising=False)
    monkeypatch.setenv("REVISIT_HOST", host)
    monkeypatch.setenv("REVISIT_PORT", "9")
    assert main(["healthcheck"]) == 1
    assert f"no service answers at {url} (" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["views", ".."], "'..' is neither a name nor an id"),
        (["maps", ""], "'' is neither a name nor an id"),
        (["maps", "--key", "a b"], "the key has letters that no key has"),
        (["maps", "--url", "http://[::1"], "'http://[::1' is no address of a service"),
        (["maps", "--url", "localhost:8000"], "'localhost:8000' is no address of a service"),
        (["maps", "--url", "ftp://bob:secret@h"], "'ftp://***@h' is no address of a service"),
        (["maps", "--url", "http://bob:secret@127.0.0.1:1"], "no service answers at http://***@127.0.0.1:1 ("),
        (["maps", "caf\udce9"], "'caf\\udce9' is neither a name nor an id"),
    ],
)
def test_what_no_call_can_be_made_with_is_told_without_a_traceback(
    argv: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([argv[0], "--url", "http://127.0.0.1:1", *argv[1:]]) == 1
    assert capsys.readouterr().err.startswith(f"revisit: {told}")


@pytest.mark.parametrize(("typed", "meant"), [("enrol", "enroll"), ("health-check", "healthcheck"), ("quer", "query")])
def test_a_command_that_is_mistyped_is_told_with_the_nearest(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main([typed, "photos"])
    assert caught.value.code == 2
    assert f"there is no command {typed!r}; did you mean {meant!r}?" in capsys.readouterr().err


@pytest.mark.parametrize("argv", [["maps"], ["views", "--place", "hall", "--delete"], ["healthcheck"]])
def test_a_mistyped_address_calls_no_other_service(
    argv: list[str], service: FakeService, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("REVISIT_URL", service.url)
    monkeypatch.setenv("REVISIT_ULR", "http://127.0.0.1:1")
    assert main(argv) == 1
    assert capsys.readouterr().err == (
        "revisit: unknown setting REVISIT_ULR; did you mean REVISIT_URL? docs/settings.md lists all of them\n"
    )
    assert service.requests == []


@pytest.mark.parametrize("closed", ["2>&-", "<&- 2>&-"])
def test_what_is_said_goes_nowhere_where_stderr_is_closed(closed: str) -> None:
    command = f'exec "$0" -m app.cli maps --url http://127.0.0.1:9 {closed}'
    ended = subprocess.run(["sh", "-c", command, sys.executable], stdout=subprocess.PIPE, check=False)

    assert (ended.returncode, ended.stdout) == (1, b"")


def test_a_full_disk_behind_the_output_is_told_without_a_traceback(service: FakeService) -> None:
    service.replies["GET /maps"] = 200, {"maps": []}
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "app.cli", "maps", "--url", service.url]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (1, "revisit: the output cannot be written: No space left on device\n")


def test_whose_output_nobody_reads_does_not_say_that_all_went_well(service: FakeService) -> None:
    """`| head` ends it as it ends other programs: what failed may have stood in what was not read."""
    service.replies["GET /maps"] = 200, {"maps": []}
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "app.cli", "maps", "--url", service.url]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")
