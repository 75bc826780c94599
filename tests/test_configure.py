"""What `worker.configure` sets for the whole process."""

import os
import platform
import re
import subprocess
import sys

import pytest

CONFIGURED = """
import ctypes, threading
from worker.configure import configure

configure(1)
"""

ALLOCATING = """
together = threading.Barrier(16)

def allocate():
    together.wait()
    kept = [bytes(50_000) for _ in range(50)]
    together.wait()

threads = [threading.Thread(target=allocate) for _ in range(16)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""

TOLD = """
libc = ctypes.CDLL(None)
libc.fdopen.restype = ctypes.c_void_p
out = ctypes.c_void_p(libc.fdopen(1, b"w"))
libc.malloc_info(0, out)
libc.fflush(out)
"""
"""Prints an XML document with a `heap` for each arena, and how many blocks are the system's own."""

pytestmark = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc's allocator")


def told(program: str, **said: str) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    command = [sys.executable, "-c", CONFIGURED + program + TOLD]
    return subprocess.run(command, capture_output=True, text=True, check=True, env={**clean, **said}).stdout


@pytest.mark.parametrize(("said", "arenas"), [({}, 2), ({"MALLOC_ARENA_MAX": "4"}, 4)])
def test_threads_share_a_few_arenas_unless_somebody_says_otherwise(said: dict[str, str], arenas: int) -> None:
    assert told(ALLOCATING, **said).count("<heap nr=") == arenas


@pytest.mark.parametrize(("said", "of_its_own"), [({}, True), ({"MALLOC_MMAP_THRESHOLD_": "32000000"}, False)])
def test_the_memory_of_an_image_goes_back_once_it_is_freed(said: dict[str, str], of_its_own: bool) -> None:
    """Left alone, glibc would keep what the second one had, since it has seen the first."""

    def own_blocks(program: str) -> int:
        found = re.search('<total type="mmap" count="([0-9]+)"', told(program, **said))
        assert found
        return int(found[1])

    seen = "seen = bytes(20_000_000); del seen"
    assert own_blocks(f"{seen}; held = bytes(8_000_000)") - own_blocks(seen) == of_its_own
