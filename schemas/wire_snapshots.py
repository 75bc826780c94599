"""Models of the answers about snapshots."""

from pydantic import Field

from .wire_views import Answer, Moment


class Snapshot(Answer):
    """A snapshot of a map that the service keeps."""

    id: str
    map: str = Field(description="Name of the map when it was made.")
    created_at: Moment
    revision: int = Field(description="Of the map that it holds.")
    recipe: str = Field(description="Id of the map's description recipe.")
    views: int
    image_bytes: int = Field(description="Of all images in it.")
    bytes: int = Field(description="Of the file.")
    links: dict[str, str]


class Snapshots(Answer):
    """All snapshots that the caller may use, newest first."""

    snapshots: list[Snapshot]


class RestoredMap(Answer):
    """A map that was made from a snapshot."""

    map: str
    snapshot: str = Field(description="Id of the snapshot.")
    views: int
    pending: int = Field(description="Views that are described anew, since the snapshot had no description of them.")
    revision: int = Field(description="Of the map.")
    new_ids: bool = Field(description="Whether its views got new ids, because one of theirs was in use already.")
    links: dict[str, str]
