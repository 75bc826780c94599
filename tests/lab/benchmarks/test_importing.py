"""The recordings of the importing benchmark hold the same images, and what was not imported is no rate."""

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest

from lab.benchmarks.importing import imported, recordings


class Imports:
    """A service that says that so many images of a recording became views."""

    def __init__(self, ready: int) -> None:
        self.ready = ready

    def import_recording(self, recording: Path, map: str) -> Any:
        return SimpleNamespace(id="job")

    def wait_for_job(self, job_id: str, timeout: float) -> Any:
        return SimpleNamespace(state="done", result={})

    def map(self, name: str) -> Any:
        return SimpleNamespace(views={"ready": self.ready})


def test_zip_folder_and_video_hold_the_same_images(tmp_path: Path) -> None:
    paths = recordings(tmp_path, 3)
    with zipfile.ZipFile(paths["zip"]) as archive:
        inside = {name: archive.read(name) for name in archive.namelist()}
    assert inside == {file.name: file.read_bytes() for file in paths["folder"].iterdir()}
    assert len(inside) == 3
    assert int(cv2.VideoCapture(str(paths["video"])).get(cv2.CAP_PROP_FRAME_COUNT)) == 3


def test_a_rate_is_of_all_images() -> None:
    service: Any = Imports(ready=3)
    assert imported(service, Path("walk.zip"), "walk", 3) > 0
    with pytest.raises(SystemExit, match="3 of 4 images are views"):
        imported(service, Path("walk.zip"), "walk", 4)
