"""Models of the JSON bodies of requests."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


class PutMap(BaseModel):
    """Recipe of a map; fields left out take the service's defaults.

    Errors name the labels, presets or parameters that exist.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    labels: list[Annotated[str, Field(min_length=1, max_length=100)]] | None = Field(
        None, min_length=1, max_length=255, description="Label set, in order."
    )
    dynamic: list[Annotated[str, Field(min_length=1, max_length=100)]] | None = Field(
        None, max_length=255, description="Labels of things that move; their cells are left out of descriptions."
    )
    preset: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        None, description="Named set of parameters, such as `default` or `paper`.", examples=["default"]
    )
    parameters: dict[str, Any] | None = Field(
        None, description="Description parameters that differ from the preset's.", examples=[{"local_features": 500}]
    )
    ranking: dict[str, Any] | None = Field(
        None, description="Ranking parameters that differ from the preset's.", examples=[{"candidates": 100}]
    )


class PatchMap(BaseModel):
    """Changes of a map that take effect at once: its ranking."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    ranking: dict[str, Any] = Field(
        description="Ranking parameters to change; the others stay.", examples=[{"candidates": 100}]
    )
