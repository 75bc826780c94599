"""Describe the impostors that ship with an encoder: ``python -m training.commands.describe_impostors``.

Pictures of no place are drawn by the project (`scenes.placeless`). Places that are in no map are photographs in the
mirror: what they are of looks real, and no camera ever saw it so. Only descriptions are kept.
"""

import argparse
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import count, islice
from pathlib import Path

import numpy as np

from scenes.geometry import Pixels
from scenes.placeless import KINDS, placeless
from schemas.description import Description
from schemas.errors import NothingStatic
from schemas.image import Image
from schemas.settings import Settings
from training.commands.open_data import photographs
from training.data.images import read_rgb
from worker.description import impostors
from worker.description.describer import Describer
from worker.description.ports import Encoder
from worker.description.presets import Wanted, general_vocabulary, make_recipe
from worker.encoders.choosing import SHAREABLE, make_encoder
from worker.method.impostors import Impostors

OF_A_KIND = 2
EVERY = 8
"""Of the photographs of one folder: neighbours show the same."""


def described(encoder: Encoder, describer: Describer, of_a_kind: int, elsewhere: Iterable[Pixels] = ()) -> Impostors:
    """So many pictures of every kind of no place, then places elsewhere, described.

    Those in which the encoder sees nothing that stays are passed over.

    Parameters
    ----------
    encoder : Encoder
    describer : Describer
    of_a_kind : int
    elsewhere : iterable of uint8 RGB of shape (height, width, 3)
        With the extent `worker.description.impostors.EXTENT`.
    """
    found: list[Description] = []
    for kind in KINDS:
        images = (placeless(kind, seed) for seed in count())
        found += islice(_descriptions(encoder, describer, images), of_a_kind)
    drawn = len(found)
    found += _descriptions(encoder, describer, elsewhere)
    return Impostors(
        vectors={name: np.stack([one.vectors[name] for one in found]) for name in found[0].vectors},
        full=np.stack([one.cells for one in found]),
        extent=impostors.EXTENT,
        placeless=drawn,
    )


def mirrored(free: Path) -> Iterator[Pixels]:
    """The middle of every eighth photograph of each folder, in the mirror; share-alike ones are left out."""
    folders: dict[Path, list[Path]] = {}
    for path in photographs(free):
        folders.setdefault(path.parent, []).append(path)
    for paths in folders.values():
        for path in paths[::EVERY]:
            yield _middle(read_rgb(path))[:, ::-1]


def _middle(pixels: Pixels) -> Pixels:
    """The largest part in the middle that has the extent of all impostors."""
    height, width = pixels.shape[:2]
    across, down = impostors.EXTENT
    wide, high = min(width, round(height * across / down)), min(height, round(width * down / across))
    left, top = (width - wide) // 2, (height - high) // 2
    return pixels[top : top + high, left : left + wide]


def _descriptions(encoder: Encoder, describer: Describer, images: Iterable[Pixels]) -> Iterator[Description]:
    for pixels in images:
        image = Image.of(np.ascontiguousarray(pixels))
        [field] = encoder.encode([image])
        with suppress(NothingStatic):
            yield describer.describe(image, field, None)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, describe, write."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.describe_impostors", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--encoder", choices=SHAREABLE, required=True)
    parser.add_argument("--free", type=Path, help="folder of openly licensed photographs, as open_data takes it")
    parser.add_argument("--to", type=Path, help="file; default: where the encoder's weights are")
    parser.add_argument("--of-a-kind", type=int, default=OF_A_KIND, help="pictures of every kind of no place")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    encoder, _ = make_encoder(Settings(encoder=options.encoder), options.threads)
    recipe = make_recipe(encoder, Wanted(), preset=impostors.PRESET).description
    describer = Describer(encoder, recipe, general_vocabulary(encoder, impostors.PRESET))
    path = options.to or impostors.path_of(options.encoder)
    elsewhere = mirrored(options.free) if options.free else ()
    impostors.write(path, recipe, described(encoder, describer, options.of_a_kind, elsewhere))
    print(f"{path.name}: {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
