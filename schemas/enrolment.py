"""How an image is to be enrolled."""

from dataclasses import dataclass
from datetime import datetime

from schemas.recipe import MapRecipe
from schemas.records import MapClaim


@dataclass(frozen=True)
class EnrolmentOptions:
    """What an enrolment asks of the store beside the image and its attributes.

    Parameters
    ----------
    now : datetime
    recipe : MapRecipe or None
        Of the map, if it is to be created.
    steady_s : float or None
        Reading of a steady clock at `now`, by which the time since the last enrolment is measured.
    background : bool
        Whether other enrolments are described first.
    refuse_poor : bool
        Whether the view is to fail where its description shows that the image is poor.
    job : MapClaim or None
        The import that enrols the image. It is refused once it was cancelled or its map was deleted, even if there is
        another map of that name.
    """

    now: datetime
    recipe: MapRecipe | None = None
    steady_s: float | None = None
    background: bool = False
    refuse_poor: bool = False
    job: MapClaim | None = None
