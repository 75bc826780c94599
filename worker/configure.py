"""Settings of the whole process: threads of each library, the interpreter's switch interval, the allocator."""

import ctypes
import sys
from importlib.util import find_spec

import cv2
import faiss

from schemas.errors import SetupError

SWITCH_S = 0.001
"""Seconds after which a thread releases the interpreter to another. The encoder's thread needs it for a moment
between native calls; Python's default of 5 ms delayed an enrolment by a tenth (docs/speed.md)."""


def configure(threads: int) -> None:
    """Set the threads of OpenCV and FAISS and the switch interval of the process.

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
        There is no torch, or no such device.
    """
    if not has_torch():
        raise SetupError(
            "this needs torch, which this installation was made without (--slim, or TORCH=none for an image); "
            "without it there is REVISIT_ENCODER=compact with REVISIT_DEVICE=cpu"
        )
    import torch

    torch.set_num_threads(threads)
    if device != "cpu" and not torch.cuda.is_available():
        raise SetupError(f"REVISIT_DEVICE={device}, but this torch sees no GPU; set it to cpu")


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
