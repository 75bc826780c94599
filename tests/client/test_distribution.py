"""`pip install ./client` installs the client and the service's wire models, and nothing else of the service."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import revisit_client

from app.version import VERSION
from tests.stories.running import RunningService

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "client" / "revisit_client"
PARTS = (
    "wire.py",
    "wire_calibration.py",
    "wire_changes.py",
    "wire_deletions.py",
    "wire_health.py",
    "wire_inbox.py",
    "wire_query.py",
    "wire_readiness.py",
    "wire_shadow.py",
    "wire_snapshots.py",
    "wire_views.py",
)
WIRE = [ROOT / "schemas" / name for name in PARTS]

SERVER = {
    "app",
    "worker",
    "schemas",
    "lab",
    "scenes",
    "training",
    "tests",
    "numpy",
    "fastapi",
    "starlette",
    "sqlalchemy",
}
"""Modules that a program with the client must not load."""

LOADED = (
    "import revisit_client, sys; print(revisit_client.__file__); print(*{m.partition('.')[0] for m in sys.modules})"
)


def run(folder: Path, *arguments: str, **variables: str) -> str:
    """The output of a fresh interpreter that can import only `folder` of this checkout."""
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=bare | variables,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def imported(path: Path) -> set[str]:
    """Top-level names of all modules that a file imports, but for its neighbours."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module is not None
            assert node.level <= 1
            if node.level == 0:
                names.add(node.module.partition(".")[0])
    return names


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of `client/` with the file that it links to, for building in."""
    folder = tmp_path_factory.mktemp("checkout")
    traces = shutil.ignore_patterns("build", "dist", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT / "client", folder / "client", symlinks=True, ignore=traces)
    (folder / "schemas").mkdir()
    for wire in WIRE:
        shutil.copy(wire, folder / "schemas")
    return folder / "client"


@pytest.fixture(scope="module")
def wheel(source: Path) -> Path:
    pip = ("-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation")
    run(source.parent, *pip, "--wheel-dir", "wheels", "./client")
    (built,) = (source.parent / "wheels").iterdir()
    return built


def test_the_wheel_holds_the_client_and_the_wire_models_as_a_file(wheel: Path) -> None:
    assert wheel.name == f"revisit_client-{VERSION}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        assert held == {f"revisit_client/{path.name}" for path in (*PACKAGE.glob("*.py"), PACKAGE / "py.typed")}
        for wire in WIRE:
            assert archive.read(f"revisit_client/{wire.name}") == wire.read_bytes()


def test_a_source_distribution_holds_the_wire_models_as_a_file_too(source: Path) -> None:
    run(source, "-c", "from setuptools import build_meta; build_meta.build_sdist('dist')")
    with tarfile.open(source / "dist" / f"revisit_client-{VERSION}.tar.gz") as archive:
        for wire in WIRE:
            member = archive.getmember(f"revisit_client-{VERSION}/revisit_client/{wire.name}")
            assert member.isfile()
            content = archive.extractfile(member)
            assert content is not None
            assert content.read() == wire.read_bytes()


def test_the_wheel_alone_is_imported_without_anything_of_the_service(wheel: Path) -> None:
    where, loaded = run(
        wheel.parent, "-I", "-c", f"import sys; sys.path.insert(0, {str(wheel)!r}); {LOADED}"
    ).splitlines()

    assert where.startswith(str(wheel))
    assert set(loaded.split()) & SERVER == set()


def test_the_checkout_too_imports_the_client_without_the_service() -> None:
    where, loaded = run(ROOT / "client", "-c", LOADED).splitlines()

    assert where.startswith(str(PACKAGE))
    assert set(loaded.split()) & SERVER == set()


def test_its_files_import_httpx_pydantic_and_the_standard_library_only() -> None:
    allowed = {"httpx", "pydantic", "revisit_client"} | sys.stdlib_module_names
    strays = {path.name: imported(path) - allowed for path in PACKAGE.glob("*.py")}

    assert {name: modules for name, modules in strays.items() if modules} == {}


def test_there_is_one_source_of_the_wire_models_and_it_needs_pydantic_only() -> None:
    for wire in WIRE:
        assert (PACKAGE / wire.name).samefile(wire)
        assert imported(wire) - sys.stdlib_module_names == {"pydantic"}


def test_its_version_and_what_it_needs_are_the_services() -> None:
    project = tomllib.loads((ROOT / "client" / "pyproject.toml").read_text())["project"]
    server = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    assert project["version"] == VERSION
    assert [re.split(r"[>=<]", text)[0] for text in project["dependencies"]] == ["httpx", "pydantic"]
    assert set(project["dependencies"]) <= set(server["dependencies"])
    assert project["requires-python"] == server["requires-python"]


def test_what_it_exports_is_there() -> None:
    assert set(revisit_client.__all__) <= set(vars(revisit_client))


def test_the_examples_of_its_readme_run(wheel: Path, tmp_path: Path) -> None:
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "client" / "README.md").read_text(), re.DOTALL)
    assert examples
    for name in ("entrance.jpg", "today.jpg"):
        shutil.copy(ROOT / "docs" / "seen.jpg", tmp_path / name)

    service = RunningService(tmp_path / "data")
    try:
        program = f"import sys; sys.path.insert(0, {str(wheel)!r})\n" + "\n".join(examples)
        program = program.replace("http://127.0.0.1:8000", service.url)
        printed = run(tmp_path, "-I", "-c", program, REVISIT_URL=service.url).splitlines()
    finally:
        service.stop()

    view, status, match, refusal, detail, errors = (line.split() for line in printed)
    assert view[1] == "True"
    assert status[0] == "matched"
    assert match[:2] == ["1", "entrance"]
    assert refusal[0] == "not-found"
    assert detail[:5] == ["there", "is", "no", "map", "'attic';"]
    assert errors == ["[]"]
