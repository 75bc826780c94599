"""Models of the answers about what changed at a place."""

from typing import Literal

from pydantic import Field

from .wire_views import Answer


class Spot(Answer):
    """A region of a photo."""

    centre: tuple[float, float] = Field(description="(x, y) of its bounding box, in fractions of the longer side.")
    extent: tuple[float, float] = Field(description="(width, height) of the box, in the same unit.")
    share: float = Field(description="Share of the photo, 0..1.", ge=0, le=1)


class Change(Answer):
    """A thing that changed."""

    kind: Literal["gone", "new", "moved"]
    label: str = Field(description="Of the thing: the map's label that fits best, which is a guess of its own.")
    instead: str | None = Field(
        description="Label of what the other photo shows in its place; null for a thing that moved."
    )
    confidence: float = Field(description="Probability that a thing changed there.", ge=0, le=1)
    then: Spot | None = Field(description="Where it was, in the earlier photo; null for a thing that is new.")
    now: Spot | None = Field(description="Where it is, in the later photo; null for a thing that is gone.")


class Changes(Answer):
    """What changed at a place since a view of it was taken."""

    status: Literal["compared", "not-aligned", "image-not-kept", "no-match", "busy"] = Field(
        description="Whether the photos could be compared. not-aligned: too few keypoints say where a thing should be; "
        "image-not-kept: there is no photo of the place as it was, or none of the query any more; no-match: the query "
        "matched no view; busy: of a query, which is answered all the same: get `/queries/{id}/changes` in a while."
    )
    detail: str | None = Field(description="Why they could not be compared, and what to do; null where they were.")
    since: str | None = Field(description="Id of the earlier view.")
    compared: float = Field(
        description="Share of the later photo that could be compared: seen in both, of nothing that moves.", ge=0, le=1
    )
    similarity: float | None = Field(
        description="Cosine that is usual between corresponding cells: the smaller, the more light and season differ."
    )
    changes: list[Change] = Field(description="Most confident first. Empty: nothing changed that could be told.")
    links: dict[str, str] = Field(description="`drawing`: both photos with the changes outlined.")
