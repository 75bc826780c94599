"""Models of the answer to whether the service is ready."""

from pydantic import Field

from .wire_views import Answer


class MapReadiness(Answer):
    """Whether a map can be served, and how far its index has followed the database."""

    state: str = Field(description="ok, or what is wrong with it.")
    revision: int = Field(description="Of the database.")
    indexed: int | None = Field(
        description="Revision that the index has; it catches up before every query. null before the first one."
    )
    recall: float | None = Field(
        None,
        description="Share of the nearest views that an approximate search finds, measured with views of the map; null "
        "where every search is exact.",
    )


class Readiness(Answer):
    """Whether the service can enrol and answer, and the state of each part."""

    ready: bool
    checks: dict[str, str] = Field(description="Name of each part: ok, or what is wrong with it.")
    maps: dict[str, MapReadiness] = Field(default_factory=dict, description="Each map by its name.")
    age_s: float = Field(0.0, description="Seconds since the checks were made.")
