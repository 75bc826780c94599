"""What the routes share: the use-cases of one runtime."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from app.http.curate import Curator
from app.http.keys import Keys, NoKeys
from app.http.lifecycle import Lifecycle
from app.http.recognise import Recogniser
from app.http.webhooks import Webhooks
from schemas.settings import Settings

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
    webhooks : Webhooks or None
        Who is told what queries found.
    """

    recogniser: Recogniser
    curator: Curator
    lifecycle: Lifecycle
    settings: Settings
    keys: Keys = field(default_factory=NoKeys)
    webhooks: Webhooks | None = None

    @classmethod
    def of(cls, runtime: "Runtime") -> "Service":
        """The use-cases of a runtime."""
        services, settings = runtime.services, runtime.settings
        webhooks = Webhooks.of(settings)
        tell = () if webhooks is None else (webhooks.tell,)
        recogniser = Recogniser(
            services.enroll, services.query, runtime.settlements, settings.queries, settings.wait, *tell
        )
        lifecycle = Lifecycle(runtime)
        lifecycle.on_drain(recogniser.drain)
        return cls(
            recogniser,
            Curator(
                services.views,
                services.renderings,
                services.maps,
                services.jobs,
                services.calibration,
                services.health,
                services.inbox,
                services.snapshots,
                runtime.store.calls,
                services.imports,
            ),
            lifecycle,
            settings,
            services.keys,
            webhooks,
        )
