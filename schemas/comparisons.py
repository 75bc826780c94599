"""Records of what a map knows of its own views: which show one spot, and what wrong answers get."""

from dataclasses import dataclass
from datetime import datetime

from schemas.records import Position


@dataclass(frozen=True)
class KnownView:
    """What is known of a view besides its image.

    Parameters
    ----------
    name : str or None
        The user's name for the place.
    position : Position
        Where it was taken, if that was given.
    same_spot : frozenset of int
        Sequence numbers of views that show the same spot by the map's own comparison.
    map : int
        Which of the maps that are searched together; those of different maps are different places.
    """

    name: str | None = None
    position: Position = Position()
    same_spot: frozenset[int] = frozenset()
    map: int = 0


@dataclass(frozen=True)
class Comparison:
    """What a view found when the map was queried with it, its own place left out.

    Parameters
    ----------
    seq : int
        Sequence number of the view.
    level : float or None
        Score of the best view of another place, 0..1; None when the map has no other place.
    gap : float or None
        By how much that exceeds the best view of yet another place, at least 0; None when there is none.
    same_spot : tuple of int
        Sequence numbers of views that show the same spot, whatever the user said of them.
    among, others : int
        Number of views of the map at that time, and of those of other places among them.
    rival, own : int or None, float or None
        The view that scores `level`, by sequence number; score of the best other view of the own place, 0..1.
    breadth : float or None
        Over how much of the image `gap` holds (`worker.method.breadth`), at least 0.
    """

    seq: int
    level: float | None
    gap: float | None
    same_spot: tuple[int, ...]
    among: int
    others: int
    rival: int | None = None
    own: float | None = None
    breadth: float | None = None


@dataclass(frozen=True)
class MapLevels:
    """Means over the compared views of a map: what wrong answers get there.

    Parameters
    ----------
    compared : int
        Number of compared views, those without another place left out.
    level, gap : float
        Means of `Comparison`'s; 0 where no comparison has one.
    others : float
        Mean number of views of other places that they were compared with.
    updated_at : datetime or None
        Of the latest comparison.
    revision : int
        Of the map when they were read.
    breadth : float or None
        Mean of `Comparison`'s; None when no comparison has one.
    own : float or None
        90th percentile of `Comparison`'s, what a sure view of the same place gets; None when no comparison has one.
    paired : int
        Number of compared views that have another view of their place.
    current : int
        Number of compared views that need not be compared again, those without another place included.
    """

    compared: int = 0
    level: float = 0.0
    gap: float = 0.0
    others: float = 0.0
    updated_at: datetime | None = None
    revision: int = 0
    breadth: float | None = None
    own: float | None = None
    paired: int = 0
    current: int = 0
