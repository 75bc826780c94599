"""The part of the wire models that is about deletions."""

from pydantic import Field

from .wire_views import Answer, Moment


class HoldingSnapshot(Answer):
    """A snapshot, made before, that still has what was deleted."""

    id: str = Field(description="`DELETE /snapshots/{id}` removes it.")
    map: str | None = Field(description="Name of the map when it was made; null where that is not known yet.")
    created_at: Moment | None = Field(description="null: it was being made, or cannot be read; it may have some of it.")
    views: int | None = Field(description="Of the deleted views, those whose image or description it has.")


class Deleted(Answer):
    """Receipt of a deletion: what is gone from where, and what still has it."""

    views: int = Field(description="Views removed from the database, with what was said of them.")
    descriptions: int = Field(0, description="Of these views, by all recipes of their map that were kept.")
    searched: int = Field(0, description="Of these views, those that were in the index; from `revision` on none is.")
    images: int = Field(description="Image files removed; a file is kept while another view has the same bytes.")
    images_shared: int = Field(0, description="Images that other views have too, and that are therefore kept.")
    queries: int = Field(0, description="Kept queries removed, with the images that were kept of them.")
    scores: int = Field(0, description="Days on which one of the views was matched, each with its scores.")
    revision: int | None
    snapshots: list[HoldingSnapshot] = Field(
        default_factory=list, description="Snapshots made before that still have some of it, newest first."
    )
    snapshots_of_others: int = Field(0, description="Further ones, of maps that the key does not allow.")
