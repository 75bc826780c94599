"""What the routes share: the use-cases of one runtime."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from app.http.curate import Curator
from app.http.keys import Keys, NoKeys
from app.http.lifecycle import Lifecycle
from app.http.mqtt import Mqtt
from app.http.query_events import Teller
from app.http.recognise import Recogniser
from app.http.webhooks import Webhooks
from schemas.settings import Settings
from schemas.wire import QueryAnswer

if TYPE_CHECKING:
    from worker.runtime import Runtime


@dataclass(frozen=True)
class Service:
    """The use-cases of one runtime, its lifecycle and its settings.

    Parameters
    ----------
    recogniser : Recogniser
        Enrols images and answers queries.
    curator : Curator
        Views, images, maps, jobs.
    lifecycle : Lifecycle
        Starts and stops the runtime, and reports its state.
    settings : Settings
    keys : Keys
        Who may call.
    tellers : sequence of Teller
        Tell others what queries found.
    """

    recogniser: Recogniser
    curator: Curator
    lifecycle: Lifecycle
    settings: Settings
    keys: Keys = field(default_factory=NoKeys)
    tellers: Sequence[Teller] = ()

    @classmethod
    def of(cls, runtime: "Runtime") -> "Service":
        """The use-cases of a runtime."""
        services, settings = runtime.services, runtime.settings
        tellers = [teller for teller in (Webhooks.of(settings), Mqtt.of(settings)) if teller is not None]

        def tell(answer: QueryAnswer) -> None:
            for teller in tellers:
                teller.tell(answer)

        recogniser = Recogniser(
            services.enroll, services.query, runtime.settlements, settings.queries, settings.wait, tell
        )
        lifecycle = Lifecycle(runtime)
        lifecycle.on_drain(recogniser.drain)
        return cls(
            recogniser,
            Curator(services, runtime.store.calls),
            lifecycle,
            settings,
            services.keys,
            tellers,
        )
