"""Queries that are kept, blurred where their map says so."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from schemas.image import Image
from schemas.inbox import QueryToKeep
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler
from worker.service.blurring import Blurring, BlurSettings


class KeepsQueries(Protocol):
    """The part of the store that keeps queries."""

    def keep(self, name: str, query: QueryToKeep) -> None:
        """Keep a query of a map, unless the map blurs other things than are blurred in it."""
        ...


class QueryKeeper:
    """Keeps queries as the store does; of a blurred one the image and the description are those of what is left.

    Parameters
    ----------
    kept : KeepsQueries
    maps : BlurSettings
    blurring : Blurring
    scheduler : Scheduler
    describers : Describers
    decode : function
        Bytes to Image; raises BadImage.
    """

    def __init__(
        self,
        kept: KeepsQueries,
        maps: BlurSettings,
        blurring: Blurring,
        scheduler: Scheduler,
        describers: Describers,
        decode: Callable[[bytes], Image],
    ) -> None:
        self._kept, self._maps, self._blurring = kept, maps, blurring
        self._scheduler, self._describers, self._decode = scheduler, describers, decode

    def keep(self, name: str, query: QueryToKeep) -> None:
        """Keep a query of a map, in which nothing is blurred yet.

        Raises
        ------
        NothingStatic
            All of it would be blurred, or what is left cannot be described.
        RevisitError
            It cannot be blurred or stored now.
        """
        words = self._maps.blur(name)
        if words:
            blurred = self._blurring.cover(self._decode(query.image), words, urgent=True)
            # Keypoints of people are features of people: they do not stay either.
            described = self._describers.of(query.recipe).submit(self._scheduler, blurred.image, urgent=True)
            query = replace(query, image=blurred.data, description=described.result().value, blurred=words)
        self._kept.keep(name, query)
