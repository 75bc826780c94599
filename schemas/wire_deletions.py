"""The part of the wire models that is about deletions."""

from pydantic import Field

from .wire_views import Answer


class Deleted(Answer):
    """Receipt of a deletion."""

    views: int
    images: int = Field(description="Image files removed; a file is kept while another view has the same bytes.")
    revision: int | None
    queries: int = Field(0, description="Kept queries removed, with the images that were kept of them.")
