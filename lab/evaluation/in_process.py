"""A house of one's own to measure, with a map for each preset."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from lab.evaluation.artist import HouseArtist
from lab.evaluation.asking import Retriever
from lab.evaluation.contender import Contender
from lab.evaluation.gallery import Artist
from lab.evaluation.service import HouseRetriever, map_of_its_own
from schemas.settings import Settings
from worker.description.presets import make_recipe
from worker.runtime import House


@contextmanager
def house_for_measuring(settings: Settings, device: str = "cpu") -> Iterator[House]:
    """A started house with a data folder of its own, which is removed afterwards.

    Parameters
    ----------
    settings : Settings
        Encoder, weights and threads are taken from them; where they keep data is not touched.
    device : str
    """
    from worker.bootstrap import build

    with tempfile.TemporaryDirectory(prefix="revisit-evaluation-") as folder:
        apart = {"data": Path(folder), "database": None, "inline_worker": True, "device": device}
        house = build(settings.model_copy(update=apart))
        house.start()
        try:
            yield house
        finally:
            house.stop()


def contender(house: House, preset: str) -> Contender:
    """A preset of a house as something to be measured."""
    recipe = make_recipe(house.encoder, preset)
    return Contender(partial(map_of_its_own, house, recipe, preset), _artist)


def _artist(retriever: Retriever) -> Artist | None:
    return HouseArtist(retriever) if isinstance(retriever, HouseRetriever) else None
