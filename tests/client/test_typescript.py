"""The TypeScript client: made from the service's own document, compiled, used by the console, run by Node."""

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from tests.http.document import document
from tests.sample_images import photo
from tests.stories.running import ROOT, RunningService

FOLDER = ROOT / "client" / "typescript"
OLD = "is old: python client/typescript/generate.py"


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", FOLDER / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tools() -> None:
    """What npm installs into the client's folder."""
    if not (FOLDER / "node_modules").is_dir():
        pytest.skip("NOT COMPILED: run npm ci in client/typescript; its sources are held against their sums alone")


def test_the_types_are_made_from_the_document_of_this_service(generate: ModuleType) -> None:
    first = generate.TYPES.read_text().partition("\n")[0] + "\n"
    assert first == generate.header(generate.digest_of_types(document())), f"{generate.TYPES} {OLD}"


def test_the_console_loads_what_is_made_from_the_source(generate: ModuleType) -> None:
    first = generate.SERVED.read_text().partition("\n")[0] + "\n"
    assert first == generate.header(generate.digest(generate.SOURCE.read_text())), f"{generate.SERVED} {OLD}"


@pytest.mark.usefixtures("tools")
def test_both_files_can_be_made_again(generate: ModuleType, tmp_path: Path) -> None:
    assert generate.types(document(), tmp_path) == generate.TYPES.read_text()
    assert generate.served(tmp_path) == generate.SERVED.read_text()


@pytest.mark.usefixtures("tools")
def test_mistakes_are_found_while_compiling(tmp_path: Path) -> None:
    compiler = FOLDER / "node_modules" / ".bin" / "tsc"
    options = ["--noEmit", "--strict", "--target", "ES2022", "--module", "ES2022", "--moduleResolution", "bundler"]
    done = subprocess.run(
        [compiler, *options, FOLDER / "test" / "types.ts"], capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.usefixtures("tools")
def test_a_program_for_node_compiles_without_the_types_of_a_browser(tmp_path: Path) -> None:
    """By the names that @types/node makes global: of fetch it has these."""
    compiler = FOLDER / "node_modules" / ".bin" / "tsc"
    subprocess.run([compiler, "--project", FOLDER, "--declaration", "--outDir", tmp_path], check=True, timeout=120)
    shutil.copy(FOLDER / "src" / "openapi.d.ts", tmp_path)
    (tmp_path / "node.d.ts").write_text(
        "declare class AbortSignal {}\ndeclare class Blob {}\ndeclare class FormData {}\ndeclare class Response {}\n"
        "interface RequestInit { body?: string | Blob | FormData | null }\n"
        "declare function fetch(address: string, init?: RequestInit): Promise<Response>;\n"
    )
    options = ["--noEmit", "--strict", "--target", "ES2022", "--lib", "ES2022", "--moduleResolution", "bundler"]
    files = [tmp_path / "revisit.d.ts", tmp_path / "node.d.ts"]
    done = subprocess.run(
        [compiler, *options, "--module", "ES2022", *files], capture_output=True, text=True, timeout=120, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (0, "")


def test_node_speaks_to_a_service(generate: ModuleType, tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("NOT RUN BY NODE: there is none; the browser's tests run the same file")
    image = tmp_path / "gate.jpg"
    image.write_bytes(photo())
    module = tmp_path / "revisit.mjs"
    module.write_text(generate.SERVED.read_text())
    with RunningService(tmp_path / "data") as service:
        done = subprocess.run(
            [node, FOLDER / "test" / "live.mjs", service.url, module, image],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {
        "filename": "gate.jpg",
        "place": "gate",
        "ready": 1,
        "thumbnail": "image/jpeg",
        "problems": [
            [404, "not-found", 0],
            [422, "invalid-parameter", 1],
            *[[0, "", 0]] * 7,
            [422, "idempotency-key-reused", 0],
            "Error: another page",
            *["Error: a newer frame"] * 2,
        ],
    }


def test_gateways_aborts_and_streams_are_told_apart_from_a_service_that_is_away(
    generate: ModuleType, tmp_path: Path
) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("NOT RUN BY NODE: there is none")
    module = tmp_path / "revisit.mjs"
    module.write_text(generate.SERVED.read_text())
    done = subprocess.run([node, FOLDER / "test" / "odd.mjs", module], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    aborted, busy, gateway, stream, address = json.loads(done.stdout)
    assert aborted == "Error: another page"
    assert (busy["status"], busy["waits"]) == (503, True)
    assert gateway == {"status": 502, "title": "Status 502", "detail": "", "errors": [], "waits": False}
    assert stream == {"sent": 3000}
    assert (address["status"], address["title"]) == (0, "Nothing was sent")
