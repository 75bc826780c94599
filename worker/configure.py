"""Settings of the whole process: threads of each library, the interpreter's switch interval, the allocator, no core."""

import ctypes
import os
import resource
import sys
from contextlib import suppress
from importlib.util import find_spec

import cv2
import faiss

from schemas.errors import SetupError

SWITCH_S = 0.001
"""Seconds after which a thread releases the interpreter to another. The encoder's thread needs it for a moment
between native calls; Python's default of 5 ms delayed an enrolment by a tenth (docs/speed.md)."""

ARENAS = 2
"""Of glibc's allocator, for all threads."""

GIVEN_BACK_BYTES = 4_000_000
"""Memory of this size goes back to the system once it is freed: images, bodies. By default glibc keeps blocks of up to
32 MB as soon as it has seen one."""

KEPT_BYTES = 64_000_000
"""At the end of an arena, which the next query needs again."""


def configure(threads: int) -> None:
    """Set the threads of OpenCV and FAISS, the switch interval and the allocator of the process; a crash of it writes
    no core file.

    That would have the images that were sent, not blurred yet, and the keys of callers. Who debugs can raise the limit
    of the running process (`prlimit --core`).

    `worker.__init__` sets the threads of numpy's products, `configure_torch` those of torch.

    Parameters
    ----------
    threads : int
        Of OpenCV.
    """
    cv2.setNumThreads(threads)
    # A search is memory-bound; threads that compete for cores make it several times slower.
    faiss.omp_set_num_threads(1)
    sys.setswitchinterval(SWITCH_S)
    _share_memory()
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def _share_memory() -> None:
    """Let glibc's allocator keep little of what large images needed, in no more time (docs/sizing.md).

    By default threads get arenas of their own, eight for each core, and each keeps the megabytes of the largest images
    that its threads ever worked on. What a variable of glibc says goes before; without glibc nothing is done.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        options = {
            "MALLOC_TRIM_THRESHOLD_": (-1, KEPT_BYTES),
            "MALLOC_MMAP_THRESHOLD_": (-3, GIVEN_BACK_BYTES),
            "MALLOC_ARENA_MAX": (-8, ARENAS),
        }
        for variable, (option, value) in options.items():
            if variable not in os.environ:
                libc.mallopt(option, value)


def has_torch() -> bool:
    """Whether torch is installed; it is not imported."""
    return find_spec("torch") is not None


def configure_torch(threads: int, device: str = "cpu") -> None:
    """Import torch and set its threads, for the whole process.

    Parameters
    ----------
    threads : int
    device : str
        Device on which torch runs a network.

    Raises
    ------
    SetupError
        There is no torch, or no such device: what to do.
    """
    if not has_torch():
        raise SetupError(
            "this needs torch, which this installation was made without (--slim, or TORCH=none for an image); "
            "without it there is REVISIT_ENCODER=compact with REVISIT_DEVICE=cpu"
        )
    import torch

    torch.set_num_threads(threads)
    if device == "cpu":
        return
    kind, _, number = device.partition(":")
    if kind != "cuda" or not (number.isdecimal() or device == "cuda"):
        raise SetupError(f"REVISIT_DEVICE={device} is no device; it is cpu, cuda, or cuda:1 for the second GPU")
    if torch.version.cuda is None and torch.version.hip is None:
        raise SetupError(
            f"REVISIT_DEVICE={device}, but no CUDA device was found: this installation has the CPU build of torch. "
            "Install it with `./revisit --gpu set-up` (TORCH=gpu for an image), or set REVISIT_DEVICE=cpu"
        )
    if not torch.cuda.is_available():
        raise SetupError(
            f"REVISIT_DEVICE={device}, but no CUDA device was found. `nvidia-smi` should list one here: if it does "
            "not, install NVIDIA's driver; in a container, start it with `--gpus all`, which needs NVIDIA's "
            "container toolkit. Or set REVISIT_DEVICE=cpu"
        )
    count = torch.cuda.device_count()
    if number and int(number) >= count:
        raise SetupError(f"REVISIT_DEVICE={device}, but the last CUDA device here is cuda:{count - 1}; set it to that")


def keep_freed_memory() -> None:
    """Tell glibc to keep freed memory instead of returning it to the kernel; without glibc do nothing.

    For networks in torch: ONNX Runtime has an arena of its own.

    A network's feature maps are megabytes each and live for a millisecond. By default glibc returns them to the kernel
    and gets them back zeroed, page by page: a fifth of a forward pass on one thread.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        trim_threshold, top_pad, mmap_max = -1, -2, -4
        libc.mallopt(mmap_max, 0)
        libc.mallopt(trim_threshold, 2**31 - 1)
        libc.mallopt(top_pad, 2**26)
