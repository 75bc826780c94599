"""The example in C++ is compiled and run against a service."""

import os
import shutil
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from scenes import scene
from tests.stories.photos import photo
from tests.stories.running import ROOT, RunningService

pytestmark = pytest.mark.one_database("it speaks HTTP")

SOURCE = ROOT / "deploy" / "cpp" / "place.cpp"
NAMES = ("mill lane", "the green", "school hill", "chapel row", "the quay", "north gate")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled example."""
    compiler, options = shutil.which("c++"), shutil.which("curl-config")
    if compiler is None or options is None or not Path("/usr/include/nlohmann/json.hpp").is_file():
        pytest.skip("THE C++ EXAMPLE IS NOT TRIED: needs c++, libcurl's and nlohmann-json's development files")
    libraries = subprocess.run([options, "--libs"], capture_output=True, text=True, check=True).stdout.split()
    out = tmp_path_factory.mktemp("cpp") / "place"
    strict = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *strict, "-o", str(out), str(SOURCE), *libraries], check=True)
    return out


def test_places_are_enrolled_and_known_again(program: Path, tmp_path: Path) -> None:
    for name in NAMES:
        (tmp_path / f"{name}.jpg").write_bytes(photo(scene(name).seen_from()))
    (tmp_path / "today.jpg").write_bytes(photo(scene("chapel row").seen_from(dx=0.3, turn=2)))
    (tmp_path / "elsewhere.jpg").write_bytes(photo(scene("a street nobody enrolled").seen_from()))
    (tmp_path / "notes.txt").write_text("a fine day")

    def place(*words: str, **further: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [program, *words], cwd=tmp_path, env=os.environ | further, capture_output=True, text=True, check=False
        )

    with RunningService(tmp_path / "data", REVISIT_ENCODER="compact") as service:
        here = {"REVISIT_URL": service.url, "PLACE_MAP": "museum"}
        for name in NAMES:
            assert place("enroll", name, f"{name}.jpg", **here).stdout == f"{name}.jpg: enrolled\n"
        again = place("enroll", NAMES[0], f"{NAMES[0]}.jpg", **here)
        known, unknown = place("query", "today.jpg", **here), place("query", "elsewhere.jpg", **here)
        refused, missing = place("query", "notes.txt", **here), place("query", "gone.jpg", **here)
    away = place("query", "today.jpg", **here)

    assert again.stdout.endswith("already there\n")
    assert (known.returncode, known.stdout[:12]) == (0, "chapel row (")
    assert unknown.returncode == 1
    assert (refused.returncode, "seems to be text" in refused.stderr) == (3, True)
    assert (missing.returncode, "gone.jpg cannot be read" in missing.stderr) == (3, True)
    assert (away.returncode, service.url in away.stderr) == (3, True)
    assert place().returncode == 2


@pytest.mark.parametrize(
    "body",
    [b"{}", b"[]", b'"matched"', b"null", b"<html>", b'{"status": 5}', b'{"status": "matched", "places": []}',
     b'{"status": "no_match", "reason": {}}'],
)  # fmt: skip
def test_whoever_else_answers_is_told_apart(program: Path, tmp_path: Path, body: bytes) -> None:
    class Another(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["content-length"]))
            self.send_response(200)
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    (tmp_path / "today.jpg").write_bytes(photo(scene("mill lane").seen_from()))
    with ThreadingHTTPServer(("127.0.0.1", 0), Another) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            there = os.environ | {"REVISIT_URL": f"http://127.0.0.1:{server.server_port}", "NO_PROXY": "127.0.0.1"}
            for words in (("query", "today.jpg"), ("enroll", "mill lane", "today.jpg")):
                told = subprocess.run(
                    [program, *words], cwd=tmp_path, env=there, capture_output=True, text=True, check=False
                )
                assert (told.returncode, "revisit service" in told.stderr) == (3, True), told
        finally:
            server.shutdown()
            thread.join()
