"""Parameters of images that compare two photos."""

from typing import Annotated

from pydantic import Field

from app.http.validation import Parameters
from schemas.values import SOME_ID

SomeId = Annotated[str, Field(pattern=SOME_ID)]


class ExplanationParameters(Parameters):
    """Parameters of `GET /queries/{id}/explanation.png`."""

    view: SomeId | None = Field(None, description="View id of the match to explain. Default: the best match.")


class ChangesParameters(Parameters):
    """Parameters of `GET /views/{id}/changes` and of its drawing."""

    since: SomeId = Field(description="Id of an earlier view of the same place, in the same map.")
