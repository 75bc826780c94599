"""Receipts of deletions."""

from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True)
class Holding:
    """A snapshot that still has what was deleted.

    Parameters
    ----------
    map, created_at
        None where it was being made when the deletion began, or cannot be read: it may have some of it.
    views : int or None
        Of the deleted views, those whose image or description it has; None where that cannot be told.
    """

    id: str
    map: str | None
    created_at: datetime | None
    views: int | None


@dataclass(frozen=True)
class Removal:
    """Result of a deletion: numbers removed, and the map's revision, if it still exists.

    Parameters
    ----------
    queries : int
        Kept ones.
    scores : int
        Days on which a view was matched, with its scores.
    descriptions : int
        Of the views, by all recipes.
    searched : int
        Views that were in the index.
    images_shared : int
        Images that are kept for other views.
    snapshots : tuple of Holding
    """

    views: int
    images: int
    revision: int | None
    queries: int = 0
    scores: int = 0
    descriptions: int = 0
    searched: int = 0
    images_shared: int = 0
    snapshots: tuple[Holding, ...] = ()
