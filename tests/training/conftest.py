"""A data folder of a few drawn images, with everything that training looks for."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from training.data.lexicon import ClipVectors, Lexicon
from training.data.sources import CLIP_FILE, find_classes
from training.models.checkpoints import State
from training.models.initialization import KEPT_AT_STRIDE4
from worker.encoders.compact.network import CompactNetwork

CLIP_LABELS = (
    *("road", "sidewalk", "building", "wall", "fence", "pole", "traffic sign", "traffic light", "vegetation", "tree"),
    *("terrain", "grass", "sky", "person", "cyclist", "car", "truck", "bus", "motorcycle", "bicycle", "window", "door"),
    *("floor", "ceiling", "background", "parking space", "branch", "wood", "plant", "ground", "house", "van"),
    *("motorcyclist", "stairs", "stairway", "bench", "bridge", "train", "rider", "street"),
    *("mountain", "cabinet", "chair", "table", "sofa", "bed"),
)

TRUNK_PLACES = {
    "stride2": "s2",
    "stride4": "s4",
    "stride8": "s8",
    "stride16": "s16",
    "deep": "deep",
    "context.last": "last",
    "context.local": "aspp",
    "context.whole": "pool",
    "context.joined": "cat",
}


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    """Small networks on a busy machine: threads would wait for each other most of the time."""
    torch.set_num_threads(1)


@pytest.fixture
def data_folder(tmp_path: Path) -> Path:
    """Four streets with road below and sky above, two rooms, and a square by day and by night."""
    rng = np.random.default_rng(0)
    folder = tmp_path / "data"
    (folder / "text").mkdir(parents=True)
    vectors = rng.standard_normal((len(CLIP_LABELS), 512)) + 2
    np.savez(folder / "text" / "words_ViT-B-16.npz", words=np.array(CLIP_LABELS), vectors=vectors.astype(np.float16))
    street = folder / "segmentation" / "camvid"
    for part in ("images", "labels"):
        (street / "train" / part).mkdir(parents=True)
    (street / "classes.json").write_text(json.dumps({"0": ["sky"], "1": ["road", "street"], "2": ["lane marking"]}))
    for number in range(4):
        image = rng.integers(0, 120, (96, 128, 3), np.uint8)
        image[:48] += 120
        labels = np.zeros((96, 128), np.uint8)
        labels[48:] = 1
        cv2.imwrite(str(street / "train" / "images" / f"{number}.jpg"), image)
        cv2.imwrite(str(street / "train" / "labels" / f"{number}.png"), labels)
    square = rng.integers(0, 255, (96, 128, 3), np.uint8)
    scenes = {
        "unlabelled/indoor/flat": [rng.integers(0, 255, (96, 128, 3), np.uint8) for _ in range(2)],
        "pairs/aligned/webcam/square": [square, square // 4],
    }
    for name, images in scenes.items():
        (folder / name).mkdir(parents=True)
        for number, image in enumerate(images):
            cv2.imwrite(str(folder / name / f"{number}.jpg"), image)
    return folder


@pytest.fixture
def lexicon(data_folder: Path) -> Lexicon:
    """The classes and labels of the data folder."""
    return Lexicon(ClipVectors(data_folder / CLIP_FILE), find_classes(data_folder))


@pytest.fixture
def trunk() -> State:
    """A trunk of random weights, under the names of its file."""
    torch.manual_seed(3)
    drawn = {"cls.weight": torch.randn(19, 128, 1, 1), "cls.bias": torch.randn(19)}
    for name, tensor in CompactNetwork().state_dict().items():
        for place, stage in TRUNK_PLACES.items():
            if name.startswith(f"{place}."):
                rest = name.removeprefix(f"{place}.")
                if stage == "s4":
                    block, rest = rest.split(".", 1)
                    rest = f"{KEPT_AT_STRIDE4[int(block)]}.{rest}"
                rest = rest.replace("convolutions.", "m.").replace("convolution.", "c.")
                drawn[f"{stage}.{rest}"] = tensor
    return drawn
