"""The use-cases of one house, for the routes."""

from dataclasses import dataclass

from app.http.changes import Changes
from app.http.curate import Curator
from app.http.explanations import Explanations
from app.http.lifecycle import Condition
from app.http.recognise import Recogniser
from schemas.settings import Settings
from worker.runtime import House


@dataclass(frozen=True)
class Service:
    """What the routes are given.

    Parameters
    ----------
    recogniser : Recogniser
        Enrols and answers.
    curator : Curator
        Looks after what is enrolled.
    condition : Condition
        Starts, stops, and says how the service is.
    settings : Settings
    """

    recogniser: Recogniser
    curator: Curator
    condition: Condition
    settings: Settings

    @classmethod
    def of(cls, house: House) -> "Service":
        """The use-cases around a house."""
        explanations = Explanations(house.settings.explanations)
        return cls(
            Recogniser(house, explanations),
            Curator(house, explanations, Changes(house)),
            Condition(house),
            house.settings,
        )
