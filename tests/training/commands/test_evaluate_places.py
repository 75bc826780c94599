"""A checkpoint is judged by the service's own code, with the checkpoint's own embeddings and vocabulary."""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from schemas.description import PixelField
from schemas.image import Image
from training.commands.evaluate_places import main
from training.data.lexicon import ClipVectors
from training.data.sources import CLIP_FILE
from training.models.network import TrainedNetwork
from worker.encoders.compact.encoder import CompactEncoder

PLACES = 4
GENERAL_IMAGES = 6
"""Images of the data folder that a general vocabulary is trained on."""


@pytest.fixture
def places(data_folder: Path) -> Path:
    """The data folder with four drawn places seen twice, the second time a little darker."""
    folder = data_folder / "places" / "streets"
    for kind, light in (("database", 1.0), ("query", 0.9)):
        (folder / kind).mkdir(parents=True)
        for number in range(PLACES):
            blocks = np.random.default_rng(number).integers(0, 256, (6, 8, 3)).astype(np.uint8)
            pixels = cv2.resize(blocks, (160, 120), interpolation=cv2.INTER_NEAREST)
            cv2.imwrite(str(folder / kind / f"{number}.png"), (pixels * light).astype(np.uint8))
    with (folder / "ground_truth.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("query_folder", "query_file", "database_folder", "database_file"))
        rows.writerows(("query", f"{number}.png", "database", f"{number}.png") for number in range(PLACES))
    return data_folder


@pytest.fixture
def checkpoint(data_folder: Path, tmp_path: Path) -> Path:
    """A random network that finds road everywhere: what moves would take no part in recognition."""
    torch.manual_seed(0)
    network = TrainedNetwork()
    with torch.no_grad():
        network.words.get_parameter("bias").add_(torch.from_numpy(ClipVectors(data_folder / CLIP_FILE).vector("road")))
    saved = {"average": network.state_dict(), "step": 1, "seconds": 1.0, "plan": {}}
    torch.save(saved, tmp_path / "checkpoint.pt")
    return tmp_path / "checkpoint.pt"


def test_a_checkpoint_describes_everything_that_it_is_judged_by(
    checkpoint: Path, places: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    encoded: list[str] = []

    class Watched(CompactEncoder):
        def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
            encoded.extend(image.digest for image in images)
            return super().encode(images)

    monkeypatch.setattr("training.commands.evaluate_places.CompactEncoder", Watched)
    given = ["--network", str(checkpoint), "--data", str(places), "--preset", "paper"]

    assert main([*given, "--pairs", "streets", "--json", str(tmp_path / "figures.json")]) == 0

    [figures] = json.loads((tmp_path / "figures.json").read_text())
    assert figures["dataset"] == "streets query -> database"
    assert [method["method"] for method in figures["methods"]] == ["paper", "paper, histograms alone"]
    assert figures["methods"][0]["refused"] == {}
    assert len(encoded) == GENERAL_IMAGES + 2 * PLACES
    assert "streets query -> database" in capsys.readouterr().out


def test_sets_that_do_not_exist_are_refused_by_name(
    checkpoint: Path, places: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["--network", str(checkpoint), "--data", str(places), "--pairs", "nordland"])
    assert "--pairs nordland fits none of: streets query -> database" in capsys.readouterr().err


def test_a_data_folder_without_places_is_refused(
    checkpoint: Path, data_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--network", str(checkpoint), "--data", str(data_folder)]) == 2
    assert "no ground_truth.csv" in capsys.readouterr().err
