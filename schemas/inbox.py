"""Records of queries that are kept: those that matched nothing, and those that matched a view but look unlike it."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from schemas.description import Description, Floats, LocalFeatures
from schemas.recipe import DescriptionRecipe

MOST_KEPT = 10_000
"""Queries of a kind that a map keeps at most."""


@dataclass(frozen=True, eq=False)
class QueryToKeep:
    """A query that its map may keep.

    Parameters
    ----------
    id : str
    recipe : DescriptionRecipe
        By which it was described.
    description : Description
    image : bytes
        Small, a JPEG.
    queried_at : datetime
    match : (int, float) or None
        The view that it matched, by its sequence number, and the score, 0..1; None: it matched nothing.
    blurred : tuple of str
        What was covered in the image, and is not in the description either.
    """

    id: str
    recipe: DescriptionRecipe
    description: Description
    image: bytes
    queried_at: datetime
    match: tuple[int, float] | None = None
    blurred: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class KeptQuery:
    """A query that is kept.

    Parameters
    ----------
    recipe : str
        Id of the recipe that described it.
    vectors : float32 of shape (dimensions,)
        Histogram vectors, the channels concatenated.
    keypoints : LocalFeatures or None
        None when the recipe has no local features.
    seq : int or None
        Of the view that it matched; None: it matched nothing.
    score : float or None
        Of that match, 0..1.
    """

    id: str
    recipe: str
    queried_at: datetime
    vectors: Floats
    keypoints: LocalFeatures | None
    seq: int | None = None
    score: float | None = None


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


@dataclass(frozen=True)
class Proposal:
    """Queries that matched views of one place although they look unlike them: views that would refresh the place.

    Parameters
    ----------
    queries : tuple of str
        Ids, oldest first; the first names the proposal.
    confirmed : tuple of str
        Those of them with which another one, of another image, agrees on the place.
    matched : mapping of str to str
        From the id of each query to that of the view that it matched.
    place : str or None
        Name of the place; None where the matched view has none, and stands for itself.
    lowest_score, highest_score : float
        Of the matches, 0..1.
    first_at, last_at : datetime
    """

    queries: tuple[str, ...]
    confirmed: tuple[str, ...]
    matched: Mapping[str, str]
    place: str | None
    lowest_score: float
    highest_score: float
    first_at: datetime
    last_at: datetime


@dataclass(frozen=True)
class Proposals:
    """Proposals of a map, those that most queries confirm first, and how many queries are kept and looked at."""

    proposals: tuple[Proposal, ...]
    kept: int
    examined: int
    keep_matches: int
