"""The console on a service that asks for a key."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import pytest

from tests.browser.conftest import Open, Tab
from tests.sample_images import photo as drawn_photo
from tests.stories.running import ROOT, RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Browser

Locked = tuple[RunningService, dict[str, str]]
"""A service that asks for a key, and its keys by their scopes."""


@pytest.fixture(scope="module")
def locked(
    tmp_path_factory: pytest.TempPathFactory, chromium: "Browser"
) -> Iterator[tuple[RunningService, dict[str, str]]]:
    """A service that asks for a key, a key of two scopes, and a view in its map `vault`."""
    data, keys = tmp_path_factory.mktemp("locked"), {}
    for scope in ("read", "admin"):
        command = [sys.executable, "-m", "app.cli", "keys", "create", scope, "--scope", scope, "--data", str(data)]
        made = subprocess.run([*command, "--json"], cwd=ROOT, capture_output=True, text=True, check=True)
        keys[scope] = json.loads(made.stdout)["key"]
    with RunningService(data) as running:
        headers, fields = {"x-api-key": keys["admin"]}, {"map": "vault", "place": "door"}
        files = {"image": drawn_photo(1)}
        answer = httpx.post(f"{running.url}/enroll", headers=headers, data=fields, files=files, timeout=30)
        answer.raise_for_status()
        yield running, keys


def sign_in(tab: Tab, key: str) -> None:
    tab.page.get_by_label("Key", exact=True).fill(key)
    tab.page.get_by_role("button", name="Sign in").click()


def test_a_wrong_key_is_told_and_the_right_one_is_kept_in_its_tab_alone(opened: Open, locked: Locked) -> None:
    service, keys = locked
    tab = opened("maps", url=service.url, refusals=True)
    dialog = tab.page.get_by_role("dialog")
    sign_in(tab, "rv_wrong")
    assert "key" in dialog.get_by_role("alert").inner_text().lower()
    assert tab.page.evaluate("sessionStorage.getItem('revisit-key')") is None

    sign_in(tab, keys["admin"])
    dialog.wait_for(state="detached")
    tab.page.get_by_role("link", name="vault").click()
    tab.page.wait_for_selector(".grid img[src^=blob]")
    kept = tab.page.evaluate("JSON.stringify(localStorage) + document.cookie + location.href")
    assert keys["admin"] not in kept
    tab.page.reload()
    tab.page.get_by_role("heading", name="vault").wait_for()
    another = tab.page.context.new_page()
    another.goto(f"{service.url}/#maps")
    another.get_by_role("dialog").wait_for()

    tab.page.get_by_role("button", name="Key", exact=True).click()
    tab.page.get_by_role("button", name="Forget the key").click()
    assert tab.page.evaluate("sessionStorage.getItem('revisit-key')") is None
    tab.page.get_by_role("button", name="Sign in").wait_for()


def test_what_a_key_may_not_do_is_refused_with_the_reason(opened: Open, locked: Locked) -> None:
    service, keys = locked
    tab = opened("maps/vault", url=service.url, refusals=True)
    sign_in(tab, keys["read"])
    tab.page.locator(".grid .cell button").click()
    tab.page.locator("dialog img[src]").first.wait_for()
    tab.shows_its_images()
    tab.page.get_by_role("button", name="Delete this view …").click()
    tab.confirm("Delete the view")
    assert "has the scope read; this needs write" in tab.page.get_by_role("dialog").get_by_role("alert").inner_text()


def test_a_file_that_was_chosen_to_be_restored_outlives_a_key_that_ends(
    opened: Open, locked: Locked, tmp_path: Path
) -> None:
    service, keys = locked
    (tmp_path / "vault.snapshot").write_bytes(b"x" * 1000)
    tab = opened("snapshots", url=service.url, refusals=True)
    sign_in(tab, keys["admin"])
    tab.page.get_by_role("dialog").wait_for(state="detached")
    tab.page.get_by_label("Choose a snapshot file").set_input_files(tmp_path / "vault.snapshot")
    tab.page.get_by_label("Under another name").fill("cellar")
    tab.page.evaluate("sessionStorage.setItem('revisit-key', 'rv_ended')")
    tab.page.get_by_role("button", name="Restore", exact=True).click()
    tab.page.get_by_role("dialog").wait_for()
    sign_in(tab, keys["admin"])
    tab.page.get_by_role("dialog").wait_for(state="detached")
    assert tab.page.get_by_label("Under another name").input_value() == "cellar"
    tab.page.get_by_role("button", name="Restore", exact=True).click()
    tab.page.get_by_role("alert").filter(has_text="snapshot").wait_for()
