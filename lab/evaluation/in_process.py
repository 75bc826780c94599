"""A house of one's own to measure, with a map for each preset."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from lab.evaluation.artist import ServiceArtist
from lab.evaluation.contender import Contender
from lab.evaluation.gallery import Artist
from lab.evaluation.querying import Retriever
from lab.evaluation.service import ServiceRetriever, map_of_its_own
from schemas.settings import Settings
from worker.description.presets import Wanted, make_recipe
from worker.runtime import Runtime


@contextmanager
def runtime_for_measuring(settings: Settings, device: str = "cpu") -> Iterator[Runtime]:
    """A started house with a data folder of its own, which is removed afterwards.

    Parameters
    ----------
    settings : Settings
        Encoder, weights and threads are taken from them; where they keep data is not touched.
    device : str
    """
    from worker.runtime import build

    with tempfile.TemporaryDirectory(prefix="revisit-evaluation-") as folder:
        apart = {"data": Path(folder), "database": None, "inline_worker": True, "device": device}
        runtime = build(settings.model_copy(update=apart))
        runtime.start()
        try:
            yield runtime
        finally:
            runtime.stop()


def contender(runtime: Runtime, preset: str) -> Contender:
    """A preset of a house as something to be measured."""
    recipe = make_recipe(runtime.encoder, Wanted(), preset=preset)
    return Contender(partial(map_of_its_own, runtime, recipe, preset), _artist)


def _artist(retriever: Retriever) -> Artist | None:
    return ServiceArtist(retriever) if isinstance(retriever, ServiceRetriever) else None
