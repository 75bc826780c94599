"""Reasons of verdicts: why an answer is matched or not, and what to do about it."""

from dataclasses import dataclass
from typing import Literal

from worker.method.calibration import Verdict

FEW_VIEWS = 5
"""With fewer searched views than this, an answer that stands out from nothing says so."""

Code = Literal["sure", "look-alike", "weak", "few-views", "poor-picture", "empty"]


@dataclass(frozen=True)
class Reason:
    """Why the verdict is what it is.

    Parameters
    ----------
    code : str
        ``sure``; ``look-alike``: another place is as good; ``weak``: nothing stands out from what wrong places get,
        or not enough; ``few-views``: too little is enrolled to tell; ``poor-picture``; ``empty``: there was nothing to
        search.
    detail, remedy : str
        What was seen, and what to do.
    """

    code: Code
    detail: str
    remedy: str


BETTER_PHOTO = "take another photo of the place: lit, sharp, and of things that stay"
NOTHING_SHOWN = Reason("poor-picture", "the image shows nothing", BETTER_PHOTO)
EMPTY = Reason("empty", "there was no view to compare with", "enrol images, or widen the filters")
HISTOGRAMS_ALONE = "ranked by histograms alone, by which the map does not know what wrong answers get"
OF_NO_PLACE = Reason(
    "weak",
    "the first place stands out from the others, but hardly from pictures that show no place, such as a wall close by, "
    "the sky, or a page of text",
    "take the photo so that more of the place shows",
)
LIKE_ELSEWHERE = Reason(
    "weak",
    "the first place stands out from the others of this map, but hardly from places elsewhere that look like it",
    "if the place is enrolled, enrol it from here and in this light too",
)
NOT_SO_SURE = Reason(
    "weak",
    "the first place stands out from what wrong places get in this map, but is not as sure as the precision asks for",
    "send another image; to be sure here, enrol the place from here and in this light too",
)
SURE = Reason("sure", "one place stands out from all others", "nothing")


def reason_for(status: Verdict, *, outrivalled: bool, impostor: Reason | None, searched: int) -> Reason:
    """The reason for a verdict on an answer with at least one place.

    Parameters
    ----------
    status : {"matched", "ambiguous", "no_match"}
    outrivalled : bool
        Whether the first place would be matched if there were no other place, and another one gets more than wrong
        places usually do or is taken for it.
    impostor : Reason or None
        `OF_NO_PLACE` or `LIKE_ELSEWHERE` where it would be matched if the query were compared with no impostors.
    searched : int
        Number of views searched.
    """
    if status == "matched":
        return SURE
    if outrivalled:
        return Reason(
            "look-alike",
            "the first place would be sure if another place were not nearly as good",
            "look at the rival: enrol more views of both places where they differ, take the photo so that this shows, "
            "or narrow the search with near or place",
        )
    if impostor:
        return impostor
    if searched < FEW_VIEWS:
        return Reason(
            "few-views",
            f"only {searched} view{'s' * (searched != 1)} could be searched: too few to tell what a wrong place gets",
            "enrol more views, of this place and of others",
        )
    if status == "ambiguous":
        return NOT_SO_SURE
    return Reason(
        "weak",
        "no place stands out from what wrong places get in this map",
        "if the place is enrolled, enrol it from here and in this light too",
    )
