"""Settings, commands, calls, files and versions that the documentation names exist."""

import argparse
import ast
import contextlib
import importlib
import importlib.util
import inspect
import io
import itertools
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import get_args

import pytest
from revisit_client import Revisit

from app.cli import study
from app.cli.__main__ import parser
from app.http.examples import MAP_HEALTH
from app.http.scopes import ADMIN, READ, WRITE
from app.version import VERSION
from schemas import wire
from schemas.recipe import TermWeights
from schemas.settings import Settings
from worker.method.coverage import QUARTERS, missing_directions

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


STUDIED = [page for page in PAGES if page.name != "CHANGELOG.md" and page.parent.name != "decisions"]
"""Pages whose commands are those of today."""


def studies(page: Path) -> list[tuple[str, list[str]]]:
    """Modules that a page has run, with their words; of shell variables what the page puts into them."""
    text = re.sub(r"\\\n\s*", " ", page.read_text())
    values = {name: " ".join(value.split()) for name, value in re.findall(r'^    (\w+)="([^"]*)"', text, re.MULTILINE)}
    found = re.findall(r"python -m ((?:lab|training|scenes)[\w.]*)([^`\n#&|)]*)", text)
    return [(module, re.sub(r"\$(\w+)", lambda m: values.get(m[1], "1"), rest).split()) for module, rest in found]


@cache
def study_help(module: str, *before: str) -> str:
    """What ``--help`` says after some words, which may name a command of the module's own."""
    found = importlib.import_module(module)
    if hasattr(found, "__path__"):
        found = importlib.import_module(f"{module}.__main__")
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        found.main([*before, "--help"])
    return out.getvalue()


@pytest.mark.parametrize("page", [page for page in STUDIED if studies(page)], ids=lambda p: p.name)
def test_every_study_that_a_page_runs_takes_its_options(page: Path) -> None:
    for module, words in studies(page):
        options = [word for word in words if word.startswith("--")]
        if options:
            text = study_help(module, *itertools.takewhile(lambda word: not word.startswith("--"), words))
            for option in options:
                assert re.search(rf"(?<![\w-]){option.rstrip('.,;:')}(?![\w-])", text), (module, option)


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


def test_the_clients_page_names_every_call_that_is_not_repeated_when_its_answer_got_lost() -> None:
    unsafe = set()
    for file in (ROOT / "client" / "revisit_client").glob("*.py"):
        for call in (one for one in ast.walk(ast.parse(file.read_text())) if isinstance(one, ast.FunctionDef)):
            options = {f"{one.arg}={ast.unparse(one.value)}" for one in ast.walk(call) if isinstance(one, ast.keyword)}
            if "repeat=False" in options and not call.name.startswith("_"):
                unsafe.add(call.name)
    [told] = re.findall(r"refused the second time\s+\(([^)]*)\)", (ROOT / "docs" / "client.md").read_text())

    assert set(re.findall(r"`(\w+)`", told)) == unsafe - {"readyz"}


def test_the_page_of_keys_says_what_each_scope_may() -> None:
    page = (ROOT / "docs" / "keys.md").read_text()
    rows = {scope: re.findall(rf"^\| `{scope}` \|.*$", page, re.MULTILINE) for scope in ("read", "write", "admin")}
    calls = {"read": [one for one in READ if one[0] == "POST"], "write": WRITE, "admin": ADMIN}
    for scope, routes in calls.items():
        [row] = rows[scope]
        for method, path in routes:
            if path.startswith("/compat/compreface"):
                assert "CompreFace" in row
                continue
            nouns = [part for part in path.split("/") if part and not part.startswith("{")]
            noun = nouns[-2] if nouns[-1] == "switch" else nouns[-1]
            assert noun.removesuffix("s") in row, f"{scope}: {method} {path}"


def test_members_in_examples_of_answers_exist() -> None:
    models = [one for one in vars(wire).values() if isinstance(one, type) and issubclass(one, wire.Answer)]
    known = {name for model in models for name in model.model_fields} | set(get_args(wire.HealthCode))
    known |= TermWeights(dense=1).terms().keys() | {"type", "timestamp", "data", "drawing"}  # of webhooks, and of links
    for page in PAGES:
        for block in re.findall(r"^```json\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
            assert set(re.findall(r'"([\w-]+)"\s*:', block)) <= known, page.name


def test_the_example_of_health_could_be_an_answer() -> None:
    [finding] = MAP_HEALTH["findings"]
    page = (ROOT / "docs" / "health.md").read_text()
    for heading in (finding["position"]["heading"], *map(float, re.findall(r'"heading": ([\d.]+)', page))):
        assert [QUARTERS[name] for name in missing_directions([heading])] == finding["headings"]
    assert (len(finding["views"]), MAP_HEALTH["counts"]["single-view"]) == (finding["count"], 0) != (1, 0)


def test_the_walk_through_the_files_finds_what_it_names() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| \d \| \[`([\w/.]+)`\]\(\S+\) \| `([\w.]+)`", page, re.MULTILINE)
    assert len(rows) == 7
    for file, name in rows:
        assert re.search(rf"^ *(async )?def {name.rpartition('.')[2]}\(", (ROOT / file).read_text(), re.MULTILINE), name


@pytest.mark.parametrize("file", ["nginx.conf", "fleet/nginx.conf"])
def test_limits_of_the_proxy_are_the_services(file: str) -> None:
    text = (ROOT / "deploy" / file).read_text()
    fields = Settings.model_fields
    named = re.findall(r"^ *\w+ (\d+)[sm]; *# REVISIT_(\w+)$", text, re.MULTILINE)
    assert len(named) >= 2
    for number, name in named:
        assert float(number) == fields[name.lower()].default, name
    waits = re.findall(r"proxy_read_timeout (\d+)s;", text)
    assert [int(one) > fields["wait"].default for one in waits] == [True, True]
    [told] = re.findall(r"longer than REVISIT_WAIT \((\d+) s\)", text)
    assert int(told) == fields["wait"].default
    [large] = re.findall(r"location ~ \^/\(restore\|.*?\}", text, re.DOTALL)
    assert "proxy_read_timeout 3600s;" in large  # a restoration takes minutes, and says nothing meanwhile


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
