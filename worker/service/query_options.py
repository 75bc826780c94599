"""What a query asks for, besides its image and the maps that are searched."""

from dataclasses import dataclass, field

from schemas.records import Filters

DRIVE_TIMEOUT_S = 60.0
"""Seconds of silence after which a drive begins anew."""


@dataclass(frozen=True)
class QueryOptions:
    """What a query asks for.

    Parameters
    ----------
    top : int
        Number of views returned at most.
    candidates : int or None
        Candidates of each channel that are re-ranked; None takes the map's setting, 0 ranks by histograms alone.
    zoom : float
        How many times as large the image's camera shows things as those of the maps.
    roll : float
        Degrees by which it was turned clockwise; both as for `worker.images.framing.framed`.
    filters : Filters
        Applied to each map.
    precision : float or None
        Share of matched answers that must be right, 0.5..0.999; None takes the map's setting.
    explain : bool
        Keep the query, so that its explanation can be drawn.
    drive : str or None
        Name of the drive that the image is the next one of; only with one map.
    drive_timeout_s : float
        The drive begins anew when its last image is older.
    consistent : int or None
        `matched` is said only where so many images of the drive in a row are matched one by one and come back to one
        stretch of the map; None: their evidence adds up instead.
    call : str or None
        Names the call: repeated, it is the same image of the drive, which counts once.
    keep : bool
        Whether the image may be kept among the maps' unknown places, or as a proposed view. By another camera it is
        no view of the maps, and never kept.
    """

    top: int = 5
    candidates: int | None = None
    zoom: float = 1.0
    roll: float = 0.0
    filters: Filters = field(default_factory=Filters)
    precision: float | None = None
    explain: bool = False
    drive: str | None = None
    drive_timeout_s: float = DRIVE_TIMEOUT_S
    consistent: int | None = None
    call: str | None = None
    keep: bool = True

    @property
    def of_whole_maps(self) -> bool:
        """Whether all views are searched and compared as the map says: "not here" is then said of the map."""
        return self.filters == Filters() and self.candidates != 0
