"""The use-cases of one house, for the routes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from app.http.curate import Curator
from app.http.lifecycle import Lifecycle
from app.http.recognise import Recogniser
from schemas.settings import Settings

if TYPE_CHECKING:
    from worker.runtime import Runtime


@dataclass(frozen=True)
class Service:
    """What the routes are given.

    Parameters
    ----------
    recogniser : Recogniser
        Enrols and answers.
    curator : Curator
        Looks after what is enrolled.
    lifecycle : Lifecycle
        Starts, stops, and says how the service is.
    settings : Settings
    """

    recogniser: Recogniser
    curator: Curator
    lifecycle: Lifecycle
    settings: Settings

    @classmethod
    def of(cls, runtime: "Runtime") -> "Service":
        """The use-cases of a runtime."""
        services = runtime.services
        return cls(
            Recogniser(services.enroll, services.query, runtime.settlements, runtime.settings.queries),
            Curator(services.views, services.renderings, services.maps, services.jobs, runtime.store.calls),
            Lifecycle(runtime),
            runtime.settings,
        )
