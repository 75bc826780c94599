"""Train general vocabularies: ``python -m training.commands.train_vocabulary --encoder compact --data DATA``.

General vocabularies ship with an encoder, so that the very first enrolled image can be found. Those of ``compact`` are
trained on images of many places and kinds below DATA (streets, facades, country, rooms, webcams, walks indoors) and on
none of ``DATA/places``; those of ``compact-open`` on what `training.commands.open_data` wrote there; those of ``color``
on scenes that the project draws itself.
"""

import argparse
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from scenes import scene
from scenes.scene import Kind
from schemas.description import Booleans, PixelField
from schemas.image import Image
from schemas.settings import Settings
from training.data.images import read_rgb
from worker.description.ports import Encoder
from worker.description.presets import PRESETS, Preset, adapted
from worker.description.vocabularies import SHIPPED, Vocabulary, train
from worker.encoders.choosing import make_encoder
from worker.method import labels, static_mask

FOLDERS = (
    ("segmentation/camvid/train", 120),
    ("segmentation/labelmefacade/train", 180),
    ("segmentation/nyuv2/train", 180),
    ("segmentation/ade_outdoor/train", 70),
    ("unlabelled/indoor", 250),
    ("pairs/aligned/tilde_webcam", 60),
    ("pairs/aligned/mefb", 60),
    ("pairs/same_place", 80),
)
"""Folders below DATA and how many of their images are taken: about as many indoors as outdoors."""

OPEN_FOLDERS = (
    ("segmentation/free/train", 300),
    ("unlabelled/free", 150),
    ("segmentation/drawn/train", 250),
    ("pairs/aligned", 100),
)
"""The same below a folder that `training.commands.open_data` made, for the encoder ``compact-open``."""

DRAWN: tuple[Kind, ...] = ("street", "park", "corridor")
"""Kinds of scenes for the encoder ``color``."""


def general_images(data: Path, seed: int, folders: Sequence[tuple[str, int]] = FOLDERS) -> Iterator[Image]:
    """Images of some folders, drawn by a seed; a folder with fewer gives all it has."""
    random = np.random.default_rng(seed)
    for folder, count in folders:
        every = (data / folder).rglob("*")
        files = sorted(p for p in every if p.suffix.lower() in {".jpg", ".png"} and "labels" not in p.parts)
        for number in sorted(random.permutation(len(files))[:count]):
            yield Image.of(read_rgb(files[number]))


def drawn_images(seed: int, count: int = 180) -> Iterator[Image]:
    """Scenes that the project draws."""
    for number in range(count):
        yield Image.of(scene(f"vocabulary {seed} {number}", DRAWN[number % len(DRAWN)]).pixels)


def train_vocabulary(encoder: Encoder, preset: Preset, images: Iterable[Image], seed: int) -> Vocabulary:
    """Train the vocabulary of a preset on images.

    Raises
    ------
    ValueError
        Too few images for the preset's numbers of visual words or dimensions.
    """
    text = encoder.text_vectors(preset.labels)
    dynamic = np.isin(np.array(preset.labels), np.array(preset.dynamic))
    rule = preset.parameters.dynamic

    def static(field: PixelField) -> Booleans:
        return static_mask.static_cells(labels.scores(field.semantic, text), dynamic, rule.margin, rule.most)

    fields = (field for image in images for field in encoder.encode([image]))
    return train(fields, static, preset.parameters, seed)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train and write the vocabularies of every preset."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.train_vocabulary", description="Train general vocabularies."
    )
    parser.add_argument("--encoder", choices=("compact", "compact-open", "color"), required=True)
    parser.add_argument("--data", type=Path, help="folder of the images; not needed for color")
    parser.add_argument("--preset", choices=tuple(PRESETS), action="append", help="only these; default: all")
    parser.add_argument("--to", type=Path, default=SHIPPED)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    if options.encoder != "color" and options.data is None:
        parser.error(f"--encoder {options.encoder} needs --data")
    folders = OPEN_FOLDERS if options.encoder == "compact-open" else FOLDERS
    options.to.mkdir(parents=True, exist_ok=True)
    encoder, _ = make_encoder(Settings(encoder=options.encoder), options.threads)
    for name in options.preset or PRESETS:
        drawn = options.encoder == "color"
        images = drawn_images(options.seed) if drawn else general_images(options.data, options.seed, folders)
        learned = train_vocabulary(encoder, adapted(name, encoder), images, options.seed)
        path = options.to / f"{encoder.name}-{name}.vocabulary.safetensors"
        path.write_bytes(learned.tensors)
        print(f"{path.name}: {len(learned.tensors):,} bytes, SHA-256 {learned.digest}")


if __name__ == "__main__":
    main()
