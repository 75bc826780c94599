"""Settings, commands, calls, files and versions that the documentation names exist."""

import argparse
import importlib.util
import inspect
import re
import tomllib
from functools import cache
from pathlib import Path

import pytest
from revisit_client import Revisit

from app.cli import study
from app.cli.__main__ import parser
from app.version import VERSION
from schemas.settings import Settings

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "client").glob("README.md"),
        *(ROOT / "client").glob("*/README.md"),
    ]
)
OUTSIDE = {"set-up"}
"""Commands of the launcher itself."""


def commands() -> dict[str, argparse.ArgumentParser]:
    (verbs,) = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(verbs.choices)


def settings_table() -> list[str]:
    """The rows that docs/settings.md has to have."""
    rows = []
    for name, field in Settings.model_fields.items():
        default = (
            ""
            if field.default is None
            else f"`{str(field.default).lower() if isinstance(field.default, bool) else field.default}`"
        )
        rows.append(f"| `REVISIT_{name.upper()}` | {default} | {field.description} |")
    return rows


def test_the_settings_page_is_the_settings() -> None:
    page = (ROOT / "docs" / "settings.md").read_text().splitlines()

    assert [line for line in page if line.startswith("| `REVISIT_")] == settings_table()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_that_a_page_shows_exists_with_its_options(page: Path) -> None:
    known = commands()
    for line in re.findall(r"\./revisit ([^`\n]+)", page.read_text()):
        words = [word for word in line.split() if word != "--gpu"]
        if not words or words[0] in OUTSIDE or words[0].startswith(("-", "COMMAND")):
            continue
        assert words[0].rstrip(",.;:)") in known, f"./revisit {line}"
        text = known[words[0].rstrip(",.;:)")].format_help()
        if words[0] in study.PASSED_ON:
            continue  # their modules parse the options
        for option in (word for word in words[1:] if word.startswith("--")):
            assert option.rstrip(",.;:)") in text or "..." in text, f"./revisit {line}"


def test_every_setting_that_files_name_exists() -> None:
    known = {f"REVISIT_{name}".upper() for name in Settings.model_fields} | {
        "REVISIT_GPU",
        "REVISIT_SHARED",
        "REVISIT_TEST_POSTGRES",
    }
    for path in [*PAGES, ROOT / "Dockerfile", *(p for p in (ROOT / "deploy").iterdir() if p.is_file())]:
        named = set(re.findall(r"REVISIT_[A-Z_]*[A-Z]", path.read_text()))
        assert named <= known, path.name


@cache
def anchors(page: Path) -> set[str]:
    """Where links into a page may lead: its headings in small letters, with hyphens for blanks and no punctuation."""
    heads = re.findall(
        r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE), re.MULTILINE
    )
    return {re.sub(r"[^\w -]", "", re.sub(r"\]\(.*?\)", "", head)).lower().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        target, _, anchor = link.partition("#")
        if target.startswith("http"):
            continue
        file = page.parent / target if target else page
        assert file.exists(), link
        assert not anchor or anchor in anchors(file), link


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page.name != "CHANGELOG.md" and page.parent.name != "decisions"],
    ids=lambda p: p.name,
)
def test_files_and_modules_that_a_page_names_exist(page: Path) -> None:
    text = page.read_text()
    for name in re.findall(r"`((?:app|client|deploy|lab|schemas|scenes|tests|training|worker)/[\w./-]+)", text):
        assert "NAME" in name or (ROOT / name).exists(), name
    for module in re.findall(r"python3? -m ((?:lab|scenes|training)[\w.]*)", text):
        assert importlib.util.find_spec(module.rstrip(".")) is not None, module


def test_every_call_in_the_clients_page_exists() -> None:
    page = (ROOT / "docs" / "client.md").read_text()
    named = set(re.findall(r"`(\w+)\(", page)) | set(re.findall(r"revisit\.(\w+)\(", page))

    assert named
    assert named <= set(dir(Revisit))


def test_the_clients_page_names_every_call_with_its_options() -> None:
    page = (ROOT / "docs" / "client.md").read_text()
    filters = set(inspect.signature(Revisit.delete_views).parameters) - {"self", "map", "all"}
    for name, call in inspect.getmembers(Revisit, inspect.isfunction):
        if name.startswith("_") or name == "close":
            continue
        (row,) = re.findall(rf"^\|.*`{name}\(.*$", page, re.MULTILINE)
        options = {one.name for one in inspect.signature(call).parameters.values() if one.kind is one.KEYWORD_ONLY}
        told = set(re.findall(r"(\w+)=", re.findall(rf"`{name}\(([^`]*)`", row)[0]))
        told |= filters if "filters of `query`" in row else set()
        assert "..." in row or options <= told, f"{name}: {options - told}"


def test_one_version_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    assert project["version"] == VERSION


def test_every_package_that_is_needed_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pins = (ROOT / "requirements.lock").read_text() + (ROOT / "requirements-dev.lock").read_text()
    pinned = set(re.findall(r"^([a-z0-9-]+)==", pins, re.MULTILINE))
    wanted = [*project["dependencies"], *project["optional-dependencies"]["dev"]]

    assert {re.split(r"[>=<\[ ]", text)[0].lower() for text in wanted} <= pinned


def test_every_decision_is_listed() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = (folder / "README.md").read_text()
    assert [path.name for path in sorted(folder.glob("0*.md")) if f"({path.name})" not in listed] == []


def test_nobody_is_told_to_install_what_is_not_published() -> None:
    """Revisit is on no index: `pip install 'revisit[...]'` would fetch somebody else's package."""
    told = [*PAGES, *(path for room in ("app", "worker", "schemas", "client") for path in (ROOT / room).rglob("*.py"))]
    assert [str(path) for path in told if re.search(r"pip install '?revisit\b(?!_)", path.read_text())] == []
