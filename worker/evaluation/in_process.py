"""A house of one's own to measure, with a map for each preset."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from schemas.settings import Settings
from worker.evaluation.artist import HouseArtist
from worker.evaluation.asking import Retriever
from worker.evaluation.contender import Contender
from worker.evaluation.gallery import Artist
from worker.evaluation.service import HouseRetriever, map_of_its_own
from worker.house import House
from worker.recipes import make_recipe


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
