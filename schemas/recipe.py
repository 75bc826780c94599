"""How a map describes images and how it ranks them: two halves, both data.

`DescriptionRecipe` decides every number that is stored of a view. It is hashed, names the stored rows, and changing it
describes every view anew. `RankingConfig` decides what is made of those numbers when a query is ranked. It belongs to
the map and changes at once.
"""

import hashlib
import json
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from schemas.description import DETAIL

Weight = Annotated[float, Field(ge=0, le=1000)]


class Frozen(BaseModel):
    """A value: immutable, and with no field that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Identified(Frozen):
    """A value that is named by a hash of its content."""

    @property
    def id(self) -> str:
        """First 16 hex digits of the SHA-256 of the value as canonical JSON (sorted keys, no blanks)."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


class Channel(Frozen):
    """How one layer of the pixel field becomes a histogram vector."""

    layer: str = Field(description="Layer of the encoder's pixel field that the descriptors come from.")
    vocabulary_size: Annotated[int, Field(ge=2, le=65536)] = Field(description="Size V of the vocabulary.")
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
        return self.dimensions or self.vocabulary_size


class DynamicFilter(Frozen):
    """When a cell counts as something that moves."""

    margin: Annotated[float, Field(ge=0, le=2)] = Field(
        0.0, description="By how much the best dynamic label must beat the best static one, as cosine."
    )
    most: Annotated[float, Field(ge=0, le=1)] = Field(
        1.0, description="Never drop more than this share of an image; the most certain cells go first."
    )


class CellGrid(Frozen):
    """The coarse grid of embeddings that re-ranking compares, kept in full and at half its size."""

    rows: Annotated[int, Field(ge=2, le=64)] = 16
    columns: Annotated[int, Field(ge=2, le=64)] = 28
    dimensions: Annotated[int, Field(ge=1, le=512)] = Field(32, description="Numbers of a cell, for each channel.")
    channel_weights: dict[str, Annotated[float, Field(gt=0, le=1)]] = Field(
        default_factory=dict,
        description="How much each channel counts in a cell, scaled to sum to 1; all the same when none is named.",
    )


class GraphNodes(Frozen):
    """Which regions become nodes of the context graph (paper, "Context Graph")."""

    min_region_cells: Annotated[int, Field(ge=1)] = Field(1, description="Smaller regions are no nodes.")


class DescriptionParameters(Frozen):
    """The numbers of a description."""

    channels: dict[str, Channel] = Field(min_length=1)
    seed: Annotated[int, Field(ge=0)] = Field(0, description="Of everything random: drawn descriptors, vocabulary.")
    dynamic: DynamicFilter = DynamicFilter()
    dense: CellGrid | None = None
    graph: GraphNodes = GraphNodes()
    local_features: Annotated[int, Field(ge=8, le=4096)] | None = Field(
        None, description="Keypoints kept of an image for geometric verification; null keeps none."
    )

    @model_validator(mode="after")
    def _channel_weights_are_of_channels(self) -> Self:
        unknown = [] if self.dense is None else sorted(self.dense.channel_weights.keys() - self.channels.keys())
        if unknown:
            known = ", ".join(self.channels)
            raise ValueError(f"dense.channel_weights: {', '.join(unknown)} are not among the channels {known}")
        return self

    def cell_channels(self) -> dict[str, float]:
        """Weight of each channel that a dense cell joins; empty without dense cells."""
        if self.dense is None:
            return {}
        return self.dense.channel_weights or dict.fromkeys(self.channels, 1.0)


class DescriptionRecipe(Identified):
    """Encoder, labels, parameters and vocabulary: the same recipe always makes the same description of an image."""

    encoder: str
    weights: str = Field(description="SHA-256 of the encoder's weights.")
    labels: tuple[str, ...] = Field(min_length=1)
    dynamic: tuple[str, ...]
    parameters: DescriptionParameters
    vocabulary: str = Field(description="SHA-256 of the vocabulary's tensors.")


class TermWeights(Frozen):
    """Weight of each term of the score, at least 0; they are scaled to sum to 1. At least one is above 0."""

    dense_full: Weight = Field(0.0, description="Similarity of the dense cells in full.")
    dense: Weight = Field(0.0, description="Similarity of the dense cells at half size.")
    histogram: dict[str, Weight] = Field(
        default_factory=dict, description="Similarity of the histogram vectors, by channel."
    )
    graph: Weight = Field(0.0, description="Similarity of the context graphs.")
    verification: Weight = Field(0.0, description="Bonus of geometric verification.")

    @model_validator(mode="after")
    def _some_term_counts(self) -> Self:
        if not any(self.terms().values()):
            raise ValueError("every weight is 0, so that all views would score the same; give at least one above 0")
        return self

    def terms(self) -> dict[str, float]:
        """Weights by the names that terms have in an answer, ``histogram.CHANNEL`` for the histograms."""
        named = {"dense_full": self.dense_full, "dense": self.dense}
        named |= {f"histogram.{channel}": weight for channel, weight in self.histogram.items()}
        return named | {"graph": self.graph, "verification": self.verification}


class RankingConfig(Identified):
    """How the candidates of a query are ranked. What a description lacks (cells, local features) is left out."""

    preset: str = Field("default", description="Named preset it started from; chooses the shipped calibration.")
    mode: Literal["weighted", "graph"] = Field(
        "weighted", description="weighted adds up terms; graph sorts by graph similarity alone, as the paper says."
    )
    candidates: Annotated[int, Field(ge=0, le=500)] = Field(
        20, description="Re-ranked candidates of each channel; 0 ranks by histograms alone."
    )
    weights: TermWeights = TermWeights(graph=1.0)
    full_resolution_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        10, description="How many of the best by cells at half size are compared in full."
    )
    detail_only_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        0,
        description="How many of those are also compared in full by the channel detail alone; 0 reads the cells of "
        "all channels together only. A candidate counts by the comparison in which it stands out more.",
    )
    scale_penalty: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0, description="Exponent: a view that shows the place s times as large counts min(s, 1 / s) ** scale_penalty."
    )
    graph_cosine: Annotated[float, Field(ge=-1, lt=1)] = Field(
        0.95, description="t: nodes correspond when their cosine is above this."
    )
    graph_max_edge: Annotated[float, Field(gt=0)] = Field(
        70 / 520, description="tau: longest edge of a context graph, in fractions of the longer side."
    )
    verified_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        10, description="How many of the best are verified by local features; 0 verifies none."
    )

    def detail_only(self, recipe: DescriptionRecipe) -> int:
        """`detail_only_top_k` as far as the recipe's cells join detail with something else; otherwise 0."""
        channels = recipe.parameters.cell_channels()
        return self.detail_only_top_k if DETAIL in channels and len(channels) > 1 else 0


class MapRecipe(Frozen):
    """Both halves of what a map is made with."""

    description: DescriptionRecipe
    ranking: RankingConfig
