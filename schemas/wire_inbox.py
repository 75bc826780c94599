"""Models of the answers about queries that matched nothing."""

from pydantic import Field

from .wire_views import Answer, Moment, View


class UnknownPlace(Answer):
    """Kept queries that show one spot."""

    id: str = Field(description="Of its oldest query; names it until it has a name.")
    count: int = Field(description="How many queries show it.")
    queries: list[str] = Field(description="Ids of its queries, oldest first, at most 20.")
    first_at: Moment
    last_at: Moment
    links: dict[str, str] = Field(description="`image`: a small image of its oldest query.")


class UnknownPlaces(Answer):
    """Queries of a map that matched nothing, by spot."""

    map: str
    keep_queries: int = Field(description="How many are kept at most; 0: none are (PATCH /maps/{map} changes it).")
    kept: int = Field(description="Queries that are kept.")
    examined: int = Field(description="The newest of them, which the places are made of.")
    count: int = Field(description="How many places there are, also beyond `limit`.")
    places: list[UnknownPlace] = Field(description="Those with most queries first.")


class NamedPlace(Answer):
    """What became of an unknown place that was named."""

    views: list[View] = Field(description="Made of its images; they are described in the background.")
    queries: int = Field(description="Queries removed from the unknown ones.")


class DismissedPlace(Answer):
    """What became of an unknown place that was dismissed."""

    queries: int = Field(description="Queries removed, with their images.")
