"""Models of the answers about queries that are kept: unknown places, and proposed views."""

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
    """What became of an unknown place that was named, or of a proposal that was accepted."""

    views: list[View] = Field(description="Made of its images; they are described in the background.")
    queries: int = Field(description="Queries that are not kept any more.")


class DismissedPlace(Answer):
    """What became of an unknown place, or of a proposal, that was dismissed."""

    queries: int = Field(description="Queries removed, with their images.")


class Proposal(Answer):
    """Queries that matched a place although they look unlike its views."""

    id: str = Field(description="Of its oldest query.")
    place: str | None = Field(description="Name of the place; null: the matched view has none, and stands for itself.")
    view: str = Field(description="Id of the view that the newest of its queries matched.")
    count: int = Field(description="How many queries it has.")
    confirmed: int = Field(description="How many of them another one, of another image, agrees with on the place.")
    queries: list[str] = Field(description="Ids of its queries, oldest first, at most 20.")
    lowest_score: float = Field(description="Of the matches, 0 to 1.")
    highest_score: float
    first_at: Moment
    last_at: Moment
    links: dict[str, str] = Field(description="`image`: a small image of its oldest query; `view`: the view.")


class Proposals(Answer):
    """Queries of a map that would refresh its places."""

    map: str
    keep_matches: int = Field(description="How many are kept at most; 0: none are (PATCH /maps/{map} changes it).")
    kept: int = Field(description="Queries that are kept.")
    examined: int = Field(description="The newest of them, which the proposals are made of.")
    count: int = Field(description="How many proposals there are, also beyond `limit`.")
    proposals: list[Proposal] = Field(description="Those that most queries confirm first.")
