"""Fixtures and settings of all tests."""

import gc
import os
import shutil
import ssl
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import settings

from tests import NUMPY_SPLITS_SUMS, once
from tests.compiled_once import compile_once
from tests.drawn_once import draw_once
from tests.small_images import enlarge_less

# A busy machine is slow, not wrong.
settings.register_profile("revisit", deadline=None, max_examples=60, derandomize=True)
settings.register_profile("explore", deadline=None, max_examples=600, print_blob=True)
settings.load_profile("revisit")

ROOT = Path(__file__).parents[1]
os.environ["PYTHONPATH"] = os.pathsep.join((str(ROOT), str(ROOT / "client")))  # for the processes that tests start

os.environ.setdefault("REVISIT_DECODERS", "0")
"""No processes for the services inside the tests; tests of decoding apart and the services they start have them."""

MEMORY, ROOM = Path("/dev/shm"), 8e9
if "TMPDIR" not in os.environ and os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > ROOM:
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)
"""Where the system has a large file system in memory, files of tests lie there: a disk may be slow, or fuller than the
services' reserve allows."""

SHARED = os.environ.pop("REVISIT_SHARED", None)
"""Taken out of the environment, where settings refuse a ``REVISIT_`` variable that they do not know."""

LONGEST = ("tests/stories/", "tests/browser/", "tests/encoders/", "tests/lab/", "tests/storage/")
"""Folders by how long their files take."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of single folders: those that their own conftest declares are unknown when all tests are run."""
    parser.addoption(
        "--golden-exact",
        action="store_true",
        help="tests/golden: the same to the last bit as when recorded, on the machine that recorded",
    )


@pytest.hookimpl(trylast=True)  # after they were shuffled
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that wait for processes first: the last of them would keep one core busy while the others have ended."""
    items.sort(key=lambda item: next((n for n, part in enumerate(LONGEST) if part in item.nodeid), len(LONGEST)))


def pytest_collection_finish() -> None:
    """Garbage is looked for among what tests make, not among all that was imported: a tenth of the time.

    Nor while it is imported (`pytest_configure`), of which that was a third.
    """
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    gc.enable()


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name bytes that are no text by their place: compressed ones hold the second at which a process collected, and
    pytest-xdist runs nothing where two processes name a test differently."""
    return argname if isinstance(val, bytes) and not (val.isascii() and val.decode().isprintable()) else None


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to compare bits that depend on the number of cores; spare what would be done thousands of times.

    Each client of httpx would read the certificates for HTTPS anew, for 30 ms. Of small images: `enlarge_less`; of
    scenes: `draw_once`.
    """

    gc.disable()

    @cache
    def read(files: tuple[str | None, ...], **said: Any) -> ssl.SSLContext:
        return httpx.create_ssl_context(**said)

    def context(**said: Any) -> ssl.SSLContext:
        return read((os.environ.get("SSL_CERT_FILE"), os.environ.get("SSL_CERT_DIR")), **said)

    pytest.MonkeyPatch().setattr("httpx._transports.default.create_ssl_context", context)
    enlarge_less()
    if not hasattr(config, "workerinput"):  # of pytest-xdist: in its processes alone
        once.make_folder()
        config.add_cleanup(once.remove_folder)
    draw_once()
    compile_once()
    if config.getoption("golden_exact") and NUMPY_SPLITS_SUMS:
        raise pytest.UsageError("--golden-exact needs OPENBLAS_NUM_THREADS=1: a plugin loads numpy before revisit does")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The development data: `REVISIT_SHARED`, or ``shared`` beside the checkout. Too large for the repository."""
    folder = Path(SHARED or ROOT.parent / "shared")
    if not folder.is_dir():
        pytest.skip(f"NOT RUN: needs the development data, and there is none at {folder}; set REVISIT_SHARED to it")
    return folder
