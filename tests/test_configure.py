"""What `worker.configure` sets for the whole process."""

import os
import platform
import subprocess
import sys

import pytest

ALLOCATING = """
import ctypes, threading
from worker.configure import configure

configure(1)
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
libc = ctypes.CDLL(None)
libc.fdopen.restype = ctypes.c_void_p
out = ctypes.c_void_p(libc.fdopen(1, b"w"))
libc.malloc_info(0, out)
libc.fflush(out)
"""
"""Prints an XML document with a `heap` for each arena."""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc's allocator")
@pytest.mark.parametrize(("said", "arenas"), [({}, 2), ({"MALLOC_ARENA_MAX": "4"}, 4)])
def test_threads_share_a_few_arenas_unless_somebody_says_otherwise(said: dict[str, str], arenas: int) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    run = subprocess.run(
        [sys.executable, "-c", ALLOCATING], capture_output=True, text=True, check=True, env={**environment, **said}
    )
    assert run.stdout.count("<heap nr=") == arenas
