"""The files of the console: a list that is known beforehand, to everybody, with a policy that allows nothing else."""

import re
from pathlib import Path

import pytest

from app.console.files import STATIC, files
from tests.openapi import CheckedClient

MODULES = sorted(STATIC.glob("*.js"))


def test_the_page_and_what_it_loads_are_served_and_current_copies_are_not_sent_again(client: CheckedClient) -> None:
    assert len(files()) == len(list(STATIC.iterdir()))
    for path in files():
        answer = client.get(path)
        assert (answer.status_code, answer.content) == (200, files()[path].data)
        assert answer.headers["cache-control"] == "no-cache"
        again = client.get(path, headers={"if-none-match": answer.headers["etag"]})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", answer.headers["etag"])
        head = client.head(path)
        assert (head.status_code, head.content) == (200, b"")
        assert head.headers["content-length"] == answer.headers["content-length"]
        assert head.headers["content-type"] == answer.headers["content-type"]


def test_a_file_that_changed_has_another_etag() -> None:
    assert len({file.etag for file in files().values()}) == len(files())


def test_the_policy_allows_no_other_host_and_nothing_inline(client: CheckedClient) -> None:
    for path in files():
        policy = client.get(path).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert "*" not in policy
    page = client.get("/").text
    assert not re.search(r"<style|\sstyle=|\son\w+=|<script(?![^>]* src=)", page)
    assert re.findall(r'(?:src|href)="(?!/console/|#|/docs")', page) == []


@pytest.mark.parametrize(
    "path",
    [
        "/console/../pages.py",
        "/console/%2e%2e/pages.py",
        "/console/..%2fpages.py",
        "/console/%2fetc/passwd",
        "/console/static/main.js",
        "/console//main.js",
        "/console/",
        "/console/index.html",
        "/console/main.js%00.css",
    ],
)
def test_no_other_address_reads_a_file(client: CheckedClient, path: str) -> None:
    assert client.get(path).status_code == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE"])
def test_files_are_only_read(client: CheckedClient, method: str) -> None:
    assert client.request(method, "/console/main.js").status_code == 405


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.name)
def test_modules_are_short_make_no_markup_and_load_only_each_other(path: Path) -> None:
    text = path.read_text()
    assert text.startswith("// ")
    lines = text.splitlines()
    assert len(lines) <= 400
    assert max(map(len, lines)) <= 120
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|new Function|importScripts", text
    )
    for source in re.findall(r'^import .* from "(.*)";$', text, re.MULTILINE):
        assert source.startswith("./")
        assert f"/console/{source[2:]}" in files()
    assert set(re.findall(r"https?://[^\"` ]*", text)) <= {"http://www.w3.org/2000/svg"}


def test_every_module_is_loaded_by_another_or_by_the_page() -> None:
    loaded = {name for path in MODULES for name in re.findall(r'from "\./(.*)";', path.read_text())}
    by_page = re.findall(r'<script [^>]*src="/console/(.*)"', (STATIC / "index.html").read_text())
    assert by_page == ["loading.js", "main.js"]
    assert {path.name for path in MODULES} - loaded == set(by_page)
