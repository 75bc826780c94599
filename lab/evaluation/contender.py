"""A service that takes part in an evaluation."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from lab.datasets.dataset import Dataset
from lab.evaluation.gallery import Artist
from lab.evaluation.querying import Retriever


@dataclass(frozen=True)
class Contender:
    """A service to be measured.

    Parameters
    ----------
    open : function
        Gives a retriever with nothing enrolled, for one data set; it is closed afterwards.
    artist : function or None
        Gives what draws its answers for the report, from an open retriever; None where it cannot be drawn.
    """

    open: Callable[[Dataset], AbstractContextManager[Retriever]]
    artist: Callable[[Retriever], Artist | None] | None = None
