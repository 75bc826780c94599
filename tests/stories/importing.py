"""Recordings, and the jobs that import them."""

import io
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx

from tests.sample_images import drawn, encoded
from tests.waiting import PATIENCE_S, advanced

ZIP = {"content-type": "application/zip"}


def zipped(files: Mapping[str, bytes | str]) -> bytes:
    """An archive of these files."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


def photos(count: int, size: int = 64) -> dict[str, bytes | str]:
    """Images of different places, by name."""
    return {f"walk/{i:04}.jpg": encoded(drawn(size, size, i)) for i in range(count)}


def ended(client: httpx.Client, job_id: str) -> dict[str, Any]:
    """The job once it has ended: it may take any time while it advances."""
    return advanced(
        lambda: client.get(f"/jobs/{job_id}").json(), lambda job: job["state"] not in ("waiting", "running")
    )


def is_emptied(folder: Path, within_s: float = PATIENCE_S) -> bool:
    """Whether nothing is in a folder, or soon is not: an upload is removed after its job has ended."""
    until = time.monotonic() + within_s
    while any(folder.iterdir()):
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True
