"""Models of jobs, and of shadows: a recipe beside that of a map, and what both answer."""

from typing import Any, Literal

from pydantic import Field

from .wire_views import Answer, Failure, Moment


class JobProgress(Answer):
    """Progress of a job, in images."""

    done: int
    total: int


class Job(Answer):
    """A background job."""

    id: str
    kind: Literal["describe", "recipe", "shadow", "vocabulary", "snapshot", "import"]
    state: Literal["waiting", "running", "done", "failed", "cancelled"]
    map: str
    view: str | None
    attempts: int
    progress: JobProgress | None = Field(description="Of a job of a map that has started.")
    result: dict[str, Any] | None = Field(
        description="Of a finished job, such as the id of the map's recipe, or the table of a shadow; of an import, "
        "its report so far."
    )
    created_at: Moment
    finished_at: Moment | None
    failure: Failure | None
    links: dict[str, str]


class Jobs(Answer):
    """A page of jobs, newest first."""

    jobs: list[Job]
    next: str | None = Field(description="Cursor of the next page; null on the last.")


class ShadowAnswer(Answer):
    """What one recipe answers to a query."""

    status: Literal["matched", "ambiguous", "no_match", "refused"] = Field(
        description="As of a query; refused: nothing of the image is static by this recipe's labels."
    )
    confidence: float = Field(description="That the first place is right.", ge=0, le=1)
    view: str | None = Field(description="Id of the first view, whatever the status.")
    place: str | None = Field(description="Name of its place.")
    score: float | None = Field(description="Of the first view, 0 to 1.")
    right: bool | None = Field(
        description="Whether the first place is that of the view which queried. null: of a kept query nobody knows, "
        "nor of a view whose place no other view shows."
    )
    search_ms: float
    describe_ms: float | None = Field(description="null for a view, whose description is stored.")


class ShadowQuery(Answer):
    """A query, and what both recipes answer."""

    id: str = Field(description="Of the kept query, or of the view.")
    source: Literal["kept", "view"] = Field(
        description="kept: a query that the map kept, by its small image; view: a view of the map, itself left out."
    )
    place: str | None = Field(description="Name of the view's own place.")
    at: Moment = Field(description="When it was queried, or enrolled.")
    old: ShadowAnswer
    new: ShadowAnswer
    same_place: bool = Field(description="Whether both first views are of one place, or there are none.")
    agree: bool = Field(description="Whether the status is the same and, unless it is no_match, the first place too.")


class ShadowSide(Answer):
    """Counts and means of one recipe's answers."""

    matched: int
    ambiguous: int
    no_match: int
    refused: int
    right: int = Field(description="Of those that are `known`.")
    search_ms: float | None = Field(description="Mean of searching, ranking and deciding; null without answers.")
    describe_ms: float | None = Field(description="Mean of encoding and describing; null without kept queries.")


class ShadowTotals(Answer):
    """Counts over all queries of a table."""

    queries: int
    kept: int = Field(description="Of them, queries that the map kept.")
    views: int = Field(description="Of them, views of the map.")
    agree: int
    changed_first: int = Field(description="Another first place, where at least one of the two names one.")
    became_matched: int
    stopped_matching: int
    known: int = Field(description="Queries of which the right place is known: views with another view of their place.")
    old: ShadowSide
    new: ShadowSide


class ShadowTable(Answer):
    """The differences between two recipes over the queries of a map."""

    wanted: int = Field(description="Queries that were asked for.")
    recipe: str = Field(description="Id of the recipe that the map would change over to.")
    ranking: str
    old_recipe: str
    old_ranking: str
    old_views: int = Field(description="Views that the old recipe describes.")
    new_views: int = Field(description="Views that the new recipe describes; the others would be failed.")
    old_compared: int = Field(description="Views whose comparison with their map the old verdicts rest on.")
    new_compared: int = Field(description="The same of the new verdicts: at most 32.")
    totals: ShadowTotals
    queries: list[ShadowQuery] = Field(description="Those that do not agree first.")


class Shadow(Answer):
    """A map's shadow: a recipe that describes its views beside the present one, until the map is told what to do."""

    map: str
    state: Literal["describing", "comparing", "ready"] = Field(
        description="describing its views, comparing answers, or ready: to be switched to or discarded."
    )
    job: str = Field(description="Id of its job.")
    progress: JobProgress | None = Field(description="Of its job: views described, then queries answered.")
    wanted: int = Field(description="Queries that are answered by both.")
    recipe: dict[str, Any] = Field(description="Description recipe, with its `id`, that the map would have.")
    ranking: dict[str, Any] = Field(description="Ranking config, with its `id`, that the map would have.")
    table: ShadowTable | None = Field(description="When it is ready.")
    links: dict[str, str]
