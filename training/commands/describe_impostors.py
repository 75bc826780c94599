"""Describe the pictures of no place that ship with an encoder: ``python -m training.commands.describe_impostors``.

All of them are drawn by the project (`scenes.placeless`); only their descriptions are kept.
"""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from itertools import count, islice
from pathlib import Path

import numpy as np

from scenes.placeless import KINDS, placeless
from schemas.description import Description
from schemas.errors import NothingStatic
from schemas.image import Image
from schemas.settings import Settings
from worker.description import impostors
from worker.description.describer import Describer
from worker.description.ports import Encoder
from worker.description.presets import Wanted, general_vocabulary, make_recipe
from worker.encoders.choosing import SHAREABLE, make_encoder
from worker.method.impostors import Impostors

OF_A_KIND = 2


def described(encoder: Encoder, describer: Describer, of_a_kind: int) -> Impostors:
    """So many pictures of every kind, described; those in which the encoder sees nothing that stays are passed over."""
    found: list[Description] = []
    for kind in KINDS:
        images = (Image.of(placeless(kind, seed)) for seed in count())
        several = filter(None, (_description(encoder, describer, one) for one in images))
        found += islice(several, of_a_kind)
    return Impostors(
        vectors={name: np.stack([one.vectors[name] for one in found]) for name in found[0].vectors},
        full=np.stack([one.cells for one in found]),
        extent=impostors.EXTENT,
    )


def _description(encoder: Encoder, describer: Describer, image: Image) -> Description | None:
    [field] = encoder.encode([image])
    with suppress(NothingStatic):
        return describer.describe(image, field, None)
    return None


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, describe, write."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.describe_impostors", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--encoder", choices=SHAREABLE, required=True)
    parser.add_argument("--to", type=Path, help="file; default: where the encoder's weights are")
    parser.add_argument("--of-a-kind", type=int, default=OF_A_KIND, help="pictures of every kind")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    encoder, _ = make_encoder(Settings(encoder=options.encoder), options.threads)
    recipe = make_recipe(encoder, Wanted(), preset=impostors.PRESET).description
    describer = Describer(encoder, recipe, general_vocabulary(encoder, impostors.PRESET))
    path = options.to or impostors.path_of(options.encoder)
    impostors.write(path, recipe, described(encoder, describer, options.of_a_kind))
    print(f"{path.name}: {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
