"""Process globals, set in one place: threads of every library, the interpreter's switching, the allocator."""

import ctypes
import sys

import cv2
import faiss

from schemas.errors import SetupError

SWITCH_S = 0.001
"""After how long a thread lets another one into the interpreter: the encoder's comes back for a moment between calls of
many milliseconds, and by default may have to wait 5 ms for it (a tenth of an enrolment: docs/speed.md)."""


def configure(threads: int) -> None:
    """Set what belongs to the whole process, torch apart.

    How many threads numpy's products take is set in `worker.__init__`.

    Parameters
    ----------
    threads : int
        Of OpenCV.
    """
    cv2.setNumThreads(threads)
    # A search is bound by memory; threads that contend for cores make it several times slower.
    faiss.omp_set_num_threads(1)
    sys.setswitchinterval(SWITCH_S)


def configure_torch(threads: int, device: str = "cpu") -> None:
    """Import torch and set its threads, for the whole process.

    Parameters
    ----------
    threads : int
    device : str
        Where torch runs a network.

    Raises
    ------
    SetupError
        There is no such device.
    """
    import torch

    torch.set_num_threads(threads)
    if device != "cpu" and not torch.cuda.is_available():
        raise SetupError(f"REVISIT_DEVICE={device}, but this torch sees no GPU; set it to cpu")


def keep_freed_memory() -> None:
    """Tell glibc to keep freed memory instead of handing it back; elsewhere do nothing.

    For networks in torch: ONNX Runtime has an arena of its own.

    A network's maps are megabytes each and live for a millisecond. By default glibc returns them to the kernel and
    fetches them again, zeroed, page by page: that took a fifth of a forward pass on one thread.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        trim_threshold, top_pad, mmap_max = -1, -2, -4
        libc.mallopt(mmap_max, 0)
        libc.mallopt(trim_threshold, 2**31 - 1)
        libc.mallopt(top_pad, 2**26)
