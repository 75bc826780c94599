"""Everything that decides a description: a recipe is data, and its id is the hash of that data."""

import hashlib
import json
from collections.abc import Collection
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)


class Frozen(BaseModel):
    """A value: immutable, and with no field that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Channel(Frozen):
    """How one layer of the pixel field becomes a histogram vector."""

    layer: str = Field(description="Layer of the encoder's pixel field that the descriptors come from.")
    words: Annotated[int, Field(ge=2, le=65536)] = Field(description="Size V of the vocabulary.")
    descriptors: Annotated[int, Field(ge=1)] | None = Field(
        None, description="K, drawn at random among static cells; null takes all of them."
    )
    assignments: Annotated[int, Field(ge=1, le=16)] = Field(
        1, description="Nearest words a descriptor is shared among."
    )
    temperature: Annotated[float, Field(gt=0)] = Field(
        0.05, description="Of the soft assignment, in units of cosine; without effect when assignments is 1."
    )
    normalisation: Literal["l1", "hellinger"] = Field(
        "hellinger", description="l1 sums to 1; hellinger takes the root of that."
    )
    dimensions: Annotated[int, Field(ge=2, le=4096)] | None = Field(
        None, description="Length after half-whitened PCA and scaling to unit length; null keeps the histogram."
    )

    @property
    def length(self) -> int:
        """Length of the channel's vector."""
        return self.dimensions or self.words


class Dynamic(Frozen):
    """When a cell counts as something that moves."""

    margin: Annotated[float, Field(ge=0, le=2)] = Field(
        0.0, description="By how much the best dynamic word must beat the best static one, as cosine."
    )
    most: Annotated[float, Field(ge=0, le=1)] = Field(
        1.0, description="Never drop more than this share of a picture; the surest cells go first."
    )


class DenseCells(Frozen):
    """The grid of embeddings that re-ranking compares: all candidates at half its size, the best of them in full."""

    rows: Annotated[int, Field(ge=2, le=64)] = 16
    columns: Annotated[int, Field(ge=2, le=64)] = 28
    dimensions: Annotated[int, Field(ge=1, le=512)] = Field(32, description="Numbers of a cell, for each channel.")
    shares: dict[str, Annotated[float, Field(gt=0, le=1)]] = Field(
        default_factory=dict,
        description="How much each channel counts in a cell, scaled to sum to 1; all the same when none is named.",
    )
    full_resolution_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        10, description="How many of the best are compared in full."
    )
    alone: dict[str, Annotated[int, Field(ge=0, le=100)]] = Field(
        default_factory=dict,
        description="Channels whose cells are also compared by themselves, and for how many of the best in full (0: "
        "not at all). A candidate counts by the comparison in which it stands out more.",
    )
    scale_penalty: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0, description="Exponent: a view that shows the place s times as large counts min(s, 1 / s) ** scale_penalty."
    )

    @property
    def read_alone(self) -> dict[str, int]:
        """Channels that are compared by themselves too, and for how many of the best in full, at least 1."""
        return {
            channel: full_resolution_top_k
            for channel, full_resolution_top_k in self.alone.items()
            if full_resolution_top_k
        }

    @model_serializer(mode="wrap")
    def _as_before(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is not used and came later: a recipe from before it existed keeps its identity."""
        content: dict[str, Any] = serialise(self)
        return {k: v for k, v in content.items() if v or k not in ("scale_penalty", "alone")}

    def among(self, channels: Collection[str]) -> "DenseCells":
        """The same for a recipe that has these channels only."""
        shares = {name: share for name, share in self.shares.items() if name in channels}
        alone = {
            name: full_resolution_top_k
            for name, full_resolution_top_k in self.alone.items()
            if name in channels and len(channels) > 1
        }
        return self.model_copy(update={"shares": shares, "alone": alone})


class Graph(Frozen):
    """The context graph and its comparison (paper, "Context Graph")."""

    min_region_cells: Annotated[int, Field(ge=1)] = Field(1, description="Smaller regions are no nodes.")
    cosine: Annotated[float, Field(ge=-1, lt=1)] = Field(0.95, description="t: correspondences need more than this.")
    tau: Annotated[float, Field(gt=0)] = Field(70 / 520, description="Longest edge, in fractions of the longer side.")


class Verification(Frozen):
    """Geometric verification of the first candidates by local features."""

    candidates: Annotated[int, Field(ge=1, le=100)] = Field(10, description="How many of the best are verified.")
    keypoints: Annotated[int, Field(ge=8, le=4096)] = Field(300, description="Local features kept of a picture.")


class Parameters(Frozen):
    """The numbers of a preset."""

    channels: dict[str, Channel] = Field(min_length=1)
    seed: Annotated[int, Field(ge=0)] = Field(0, description="Of everything random: drawn descriptors, vocabulary.")
    dynamic: Dynamic = Dynamic()
    candidates: Annotated[int, Field(ge=0, le=500)] = Field(20, description="Re-ranked candidates of each channel.")
    dense: DenseCells | None = None
    graph: Graph = Graph()
    verification: Verification | None = None
    ranking: Literal["weighted", "graph"] = Field(
        "weighted", description="weighted adds up terms; graph sorts by graph similarity alone, as the paper says."
    )
    weights: dict[str, float] = Field(
        default_factory=dict,
        description="Weight of each term: dense (half size), close (in full), histogram.CHANNEL, graph, verification.",
    )

    @model_validator(mode="after")
    def _shares_are_of_channels(self) -> Self:
        stray = [] if self.dense is None else sorted(self.dense.shares.keys() - self.channels.keys())
        if stray:
            raise ValueError(f"dense.shares: {', '.join(stray)} are not among the channels {', '.join(self.channels)}")
        return self

    @model_validator(mode="after")
    def _alone_are_joined(self) -> Self:
        stray = [] if self.dense is None else sorted(self.dense.alone.keys() - self.joined().keys())
        if stray:
            raise ValueError(f"dense.alone: {', '.join(stray)} are not among the cells' {', '.join(self.joined())}")
        return self

    def joined(self) -> dict[str, float]:
        """The channels that a dense cell joins, and how much each counts; none where there are no dense cells."""
        if self.dense is None:
            return {}
        return self.dense.shares or dict.fromkeys(self.channels, 1.0)


class Recipe(Frozen):
    """Encoder, labels, preset, parameters and vocabulary: the same recipe always gives the same description."""

    encoder: str
    weights: str = Field(description="SHA-256 of the encoder's weights.")
    labels: tuple[str, ...] = Field(min_length=1)
    dynamic: tuple[str, ...]
    preset: str
    parameters: Parameters
    vocabulary: str = Field(description="SHA-256 of the vocabulary's tensors.")

    @property
    def id(self) -> str:
        """First 16 hex digits of the SHA-256 of the recipe as canonical JSON (sorted keys, no blanks)."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()[:16]
