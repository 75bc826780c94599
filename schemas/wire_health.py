"""Models of the answer to a map's health over HTTP."""

from datetime import date
from typing import Literal

from pydantic import Field

from .wire_views import Answer, Position

HealthCode = Literal["twins", "ageing", "never-matched", "duplicates", "missing-directions", "single-view", "gap"]


class ScoreFall(Answer):
    """How far the scores of a place fell: medians of the mean scores of single days."""

    then: float = Field(description="Of the oldest days.")
    now: float = Field(description="Of the newest days.")
    since: date = Field(description="The first day, UTC.")
    until: date = Field(description="The last day.")
    days: int = Field(description="Days that each median is of.")


class HealthFinding(Answer):
    """One thing that a map lacks or suffers from."""

    code: HealthCode = Field(
        description="twins: places that the map takes for each other; ageing: a place whose scores fall over time; "
        "never-matched: a place that no query was matched with while others were; "
        "duplicates: views that add nothing to one another; missing-directions, single-view: a place seen from one "
        "side, or once; gap: a stretch without views."
    )
    detail: str = Field(description="What was found.")
    remedy: str = Field(description="What to do.")
    places: list[str] = Field(description="Names of the places concerned, where they have names.")
    views: list[str] = Field(description="Ids of views that show it, at most 10.")
    count: int = Field(description="How many views it concerns.")
    position: Position | None = Field(description="Where to go to mend it.")
    headings: list[float] = Field(description="Directions to photograph, degrees clockwise from north, or from +y.")
    scores: ScoreFall | None = Field(None, description="How far they fell, of ageing.")
    proposal: str | None = Field(
        None, description="Of ageing: the proposal that would refresh the place (POST /maps/{map}/proposals/{id})."
    )


class MapHealth(Answer):
    """What makes a map's answers wrong or missing, and what to do about it."""

    map: str
    revision: int
    views: int = Field(description="Described views.")
    examined: int = Field(description="The newest of them, which the findings are about.")
    compared: int = Field(
        description="Examined views that the map was queried with, in the background; twins are found among these."
    )
    counts: dict[str, int] = Field(description="Findings by code, also those beyond `limit`.")
    findings: list[HealthFinding] = Field(description="By code, the most important first; at most `limit` of each.")
