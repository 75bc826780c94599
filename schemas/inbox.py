"""Records of queries that matched nothing."""

from dataclasses import dataclass
from datetime import datetime

from schemas.description import Floats, LocalFeatures


@dataclass(frozen=True, eq=False)
class KeptQuery:
    """A query that matched nothing.

    Parameters
    ----------
    recipe : str
        Id of the recipe that described it.
    vectors : float32 of shape (dimensions,)
        Histogram vectors, the channels concatenated.
    keypoints : LocalFeatures or None
        None when the recipe has no local features.
    """

    id: str
    recipe: str
    queried_at: datetime
    vectors: Floats
    keypoints: LocalFeatures | None


@dataclass(frozen=True)
class UnknownPlace:
    """Kept queries that show one spot.

    Parameters
    ----------
    queries : tuple of str
        Ids, oldest first; the first names the place until it has a name.
    first_at, last_at : datetime
    """

    queries: tuple[str, ...]
    first_at: datetime
    last_at: datetime


@dataclass(frozen=True)
class Inbox:
    """Unknown places of a map, those with most queries first, and how many queries are kept and looked at."""

    places: tuple[UnknownPlace, ...]
    kept: int
    examined: int
    keep_queries: int
