"""Rules of the layout: imports between packages, what is loaded, the length of files, their docstrings."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("app", "worker", "schemas", "client", "lab", "scenes", "training", "tests")

MOST_LINES = 400
BANNED = ("util", "utils", "helper", "helpers", "common", "misc")

HEAVY = ("torch", "onnxruntime", "faiss", "sqlalchemy", "alembic")
"""Libraries that are slow to load; only `worker.runtime` loads them, late."""


def sources() -> Iterator[Path]:
    for room in ROOMS:
        yield from sorted((ROOT / room).rglob("*.py"))


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_imports_run_one_way() -> None:
    """The contracts are in pyproject.toml; import-linter follows every import."""
    program = Path(sys.executable).with_name("lint-imports")
    if not program.exists():
        pytest.fail("import-linter is not installed; `./revisit test` installs it")
    linted = run(str(program), "--no-cache")
    assert linted.returncode == 0, linted.stdout + linted.stderr


@pytest.mark.parametrize("module", ["app.http.application", "revisit_client", "schemas.wire"])
def test_the_application_loads_without_what_is_heavy(module: str) -> None:
    told = f"import {module}, sys; print(*(set(sys.modules) & set({HEAVY!r})))"
    loaded = run(sys.executable, "-W", "ignore", "-c", told)
    assert loaded.returncode == 0, loaded.stderr
    assert loaded.stdout.split() == []


def test_a_process_that_serves_loads_nothing_of_what_studies_it(tmp_path: Path) -> None:
    """From settings to an application that has started and answered, as `serve` does."""
    served = (
        "import sys, warnings; warnings.simplefilter('ignore')\n"
        "from fastapi.testclient import TestClient\n"
        "from app.cli import serve\n"
        "from app.http.application import create_app\n"
        "from schemas.settings import read_settings\n"
        "from worker.runtime import build\n"
        f"runtime = build(read_settings({{}}, data=__import__('pathlib').Path({str(tmp_path)!r}), encoder='color'))\n"
        "with TestClient(create_app(runtime)) as client:\n"
        "    assert client.get('/readyz').status_code == 200, client.get('/readyz').text\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules} & {'lab', 'scenes', 'training', 'matplotlib'}))"
    )
    loaded = run(sys.executable, "-c", served)
    assert loaded.returncode == 0, loaded.stderr
    assert loaded.stdout.split() == []


def test_the_image_holds_what_is_served_and_nothing_that_studies_it() -> None:
    copied = re.findall(r"^COPY (?!--from)(\S+) ", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert {"app", "client", "schemas", "worker"} <= set(copied)
    assert {"lab", "scenes", "training", "tests"}.isdisjoint(copied)
    sent = (ROOT / ".dockerignore").read_text().splitlines()
    assert sent[:2] == ["# Everything that the image does not need: what is not sent cannot end up in a layer.", "*"]
    assert {"!lab", "!scenes", "!training", "!tests"}.isdisjoint(sent)


def test_the_worker_has_at_most_eleven_entries() -> None:
    entries = [path.name for path in (ROOT / "worker").iterdir() if path.name != "__pycache__"]
    assert len(entries) <= 11, sorted(entries)


@pytest.mark.parametrize("room", ["app", "worker", "lab"])
def test_numpy_is_told_to_keep_to_one_thread_before_it_loads(room: str) -> None:
    printed = f"import {room}, os, sys; print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)"
    bare = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    told = subprocess.run(
        [sys.executable, "-c", printed], cwd=ROOT, env=bare, capture_output=True, text=True, check=False
    )
    assert told.stdout.split() == ["1", "False"], told.stderr


def imported(path: Path) -> set[str]:
    """Top-level names of all modules that a file imports, anywhere in the file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.partition(".")[0])
    return names


@pytest.mark.parametrize(
    ("room", "never"),
    [
        ("app", {"torch", "onnxruntime", "cv2", "faiss", "sqlalchemy", "alembic", "sqlite3"}),
        ("worker", {"fastapi", "starlette", "uvicorn", "app", "lab", "scenes", "training"}),
        (
            "worker/method",
            {"torch", "onnxruntime", "cv2", "faiss", "PIL", "time", "datetime", "random", "os", "io", "pathlib"},
        ),
        ("schemas", {"torch", "onnxruntime", "cv2", "faiss", "fastapi", "sqlalchemy", "worker", "app"}),
    ],
)
def test_no_file_of_a_room_imports_what_does_not_belong_there(room: str, never: set[str]) -> None:
    strays = {str(path.relative_to(ROOT)): imported(path) & never for path in (ROOT / room).rglob("*.py")}
    assert {path: names for path, names in strays.items() if names} == {}


def test_no_file_is_longer_than_four_hundred_lines() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in sources()}
    assert {path: lines for path, lines in lengths.items() if lines > MOST_LINES} == {}


def test_every_file_and_folder_says_what_it_is_for() -> None:
    named = {part.removesuffix(".py") for path in sources() for part in path.relative_to(ROOT).parts}
    assert named.isdisjoint(BANNED)


def test_every_module_begins_with_what_it_is() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for path in sources()
        if "tests" not in path.parts and ast.get_docstring(ast.parse(path.read_text())) is None
    ]
    assert silent == []
