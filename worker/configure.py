"""The C library's allocator, told what this program is like."""

import ctypes


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
