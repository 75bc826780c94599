"""How a map describes images (`DescriptionRecipe`) and how it ranks views (`RankingConfig`).

A description recipe determines all numbers stored of a view. Its hash names the stored rows; another recipe means that
every view is described again. A ranking config determines how a query ranks views by those numbers. It belongs to the
map and takes effect at once.
"""

import hashlib
import json
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from schemas.description import DETAIL

Weight = Annotated[float, Field(ge=0, le=1000)]


class Frozen(BaseModel):
    """An immutable value; unknown fields are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Identified(Frozen):
    """A value identified by a hash of its content."""

    @property
    def id(self) -> str:
        """First 16 hex digits of the SHA-256 of the value as canonical JSON (sorted keys, no spaces)."""
        text = json.dumps(self._identity(), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def _identity(self) -> dict[str, Any]:
        """What is hashed."""
        return self.model_dump(mode="json")


class Channel(Frozen):
    """How the histogram vector of a channel is computed from a layer of the pixel field."""

    layer: str = Field(description="Layer of the encoder's pixel field that the descriptors come from.")
    vocabulary_size: Annotated[int, Field(ge=2, le=65536)] = Field(description="Number of visual words, V.")
    descriptors: Annotated[int, Field(ge=1)] | None = Field(
        None, description="K, sampled at random among static cells; null takes all static cells."
    )
    assignments: Annotated[int, Field(ge=1, le=16)] = Field(
        1, description="Number of nearest visual words that a descriptor is assigned to."
    )
    temperature: Annotated[float, Field(gt=0)] = Field(
        0.05, description="Temperature of the soft assignment, in units of cosine; no effect when assignments is 1."
    )
    normalisation: Literal["l1", "hellinger"] = Field(
        "hellinger", description="l1: frequencies that sum to 1; hellinger: their square roots."
    )
    dimensions: Annotated[int, Field(ge=2, le=4096)] | None = Field(
        None, description="Length after half-whitened PCA and scaling to unit length; null: no PCA."
    )

    @property
    def length(self) -> int:
        """Length of the channel's vector."""
        return self.dimensions or self.vocabulary_size


class DynamicFilter(Frozen):
    """When a cell counts as dynamic."""

    margin: Annotated[float, Field(ge=0, le=2)] = Field(
        0.0, description="By how much the best dynamic label's cosine must exceed the best static one's."
    )
    most: Annotated[float, Field(ge=0, le=1)] = Field(
        1.0, description="Largest share of cells that may be left out; those with the largest margin go first."
    )


class CellGrid(Frozen):
    """The coarse grid of embeddings that re-ranking compares, stored at full resolution and at half size."""

    rows: Annotated[int, Field(ge=2, le=64)] = 16
    columns: Annotated[int, Field(ge=2, le=64)] = 28
    dimensions: Annotated[int, Field(ge=1, le=512)] = Field(32, description="Dimensions of a cell, per channel.")
    channel_weights: dict[str, Annotated[float, Field(gt=0, le=1)]] = Field(
        default_factory=dict,
        description="Weight of each channel in a cell, scaled to sum to 1; equal weights when empty.",
    )


class GraphNodes(Frozen):
    """Which regions become nodes of the context graph (paper, "Context Graph")."""

    min_region_cells: Annotated[int, Field(ge=1)] = Field(1, description="Regions with fewer cells are not nodes.")


class DescriptionParameters(Frozen):
    """Parameters of a description."""

    channels: dict[str, Channel] = Field(min_length=1)
    seed: Annotated[int, Field(ge=0)] = Field(0, description="Seed for sampling descriptors and training vocabularies.")
    dynamic: DynamicFilter = DynamicFilter()
    dense: CellGrid | None = None
    graph: GraphNodes = GraphNodes()
    local_features: Annotated[int, Field(ge=8, le=4096)] | None = Field(
        None, description="Keypoints stored per image for geometric verification; null: none."
    )
    local_features_side: Annotated[int, Field(ge=64, le=1280)] = Field(
        320, description="Longer side at which keypoints are found, pixels; the time grows with its square."
    )
    local_features_equalised: bool = Field(
        True, description="Whether contrast is equalised (CLAHE) before keypoints are found."
    )

    @model_validator(mode="after")
    def _channel_weights_are_of_channels(self) -> Self:
        unknown = [] if self.dense is None else sorted(self.dense.channel_weights.keys() - self.channels.keys())
        if unknown:
            known = ", ".join(self.channels)
            raise ValueError(f"dense.channel_weights: {', '.join(unknown)} are not among the channels {known}")
        return self

    def cell_channels(self) -> dict[str, float]:
        """Weight of each channel in a dense cell, not scaled; empty without dense cells."""
        if self.dense is None:
            return {}
        return self.dense.channel_weights or dict.fromkeys(self.channels, 1.0)


CAME_LATER = {
    name: DescriptionParameters.model_fields[name].default
    for name in ("local_features_side", "local_features_equalised")
}
"""Description parameters that are younger than stored recipes, with the values that those mean."""


class DescriptionRecipe(Identified):
    """Encoder, labels, parameters and vocabulary, which together determine the description of an image."""

    encoder: str
    weights: str = Field(description="SHA-256 of the encoder's weights.")
    labels: tuple[str, ...] = Field(min_length=1)
    dynamic: tuple[str, ...]
    parameters: DescriptionParameters
    vocabulary: str = Field(description="SHA-256 of the vocabulary's tensors.")

    def _identity(self) -> dict[str, Any]:
        """Parameters that came later count where they differ from how recipes before them described."""
        content = super()._identity()
        parameters = content["parameters"]
        for name, before in CAME_LATER.items():
            if parameters[name] == before:
                del parameters[name]
        return content


class TermWeights(Frozen):
    """Weights of the score's terms, scaled to sum to 1. At least one is above 0."""

    dense_full: Weight = Field(0.0, description="Similarity of the dense cells at full resolution.")
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
        """Weights by name of the term as in an answer, ``histogram.CHANNEL`` for the histograms."""
        named = {"dense_full": self.dense_full, "dense": self.dense}
        named |= {f"histogram.{channel}": weight for channel, weight in self.histogram.items()}
        return named | {"graph": self.graph, "verification": self.verification}


class RankingConfig(Identified):
    """How the candidates of a query are ranked. Terms that the description recipe cannot give are left out."""

    preset: str = Field("default", description="Preset that it is based on; selects the shipped calibration.")
    mode: Literal["weighted", "graph"] = Field(
        "weighted", description="weighted: weighted mean of the terms; graph: graph similarity alone, as in the paper."
    )
    candidates: Annotated[int, Field(ge=0, le=500)] = Field(
        20, description="Candidates of each channel that are re-ranked; 0 ranks by histograms alone."
    )
    shortlist_from: Annotated[int, Field(ge=0, le=2000)] = Field(
        0,
        description="In maps of more views than this, more are looked at where histograms hardly tell them apart; the "
        "best of them by cells at a quarter size and distance are re-ranked. Numbers up to `candidates`: no shortlist.",
    )
    shortlist_looked: Annotated[int, Field(ge=0, le=2000)] = Field(
        0, description="Up to how many views of each channel are looked at then; 0: `shortlist_from`."
    )
    shortlist_kept: Annotated[int, Field(ge=0, le=1000)] = Field(
        0, description="How many of those are re-ranked; 0: as many as `candidates` of every channel."
    )
    weights: TermWeights = TermWeights(graph=1.0)
    full_resolution_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        10, description="How many of the best by cells at half size are compared at full resolution."
    )
    detail_only_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        0,
        description="How many of those are also compared at full resolution by the channel detail alone; 0: none. "
        "Of the two similarities the larger counts, after scaling to one range.",
    )
    scale_penalty: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0,
        description="Exponent: a view that shows the place s times as large as the query counts min(s, 1 / s) ** this.",
    )
    graph_cosine: Annotated[float, Field(ge=-1, lt=1)] = Field(
        0.95, description="t: smallest cosine of corresponding nodes (exclusive)."
    )
    graph_max_edge: Annotated[float, Field(gt=0)] = Field(
        70 / 520, description="tau: longest edge of a context graph, in fractions of the longer side."
    )
    verified_top_k: Annotated[int, Field(ge=0, le=100)] = Field(
        10,
        description="How many are verified by local features: the best, and as many as if the first place had one "
        "view; 0: none.",
    )

    same_place_m: Annotated[float, Field(ge=0, le=100_000)] = Field(
        5.0, description="Views whose positions are at most this far apart show one place, metres."
    )
    precision: Annotated[float, Field(ge=0.5, le=0.999)] = Field(
        0.97, description="Share of answers with the status matched that must be right; a query may ask for another."
    )

    @property
    def searched(self) -> int:
        """How many views of each channel a search finds."""
        return max(self.candidates, self.shortlist_from, self.shortlist_looked if self.shortlist_from else 0)

    def detail_only(self, recipe: DescriptionRecipe) -> int:
        """`detail_only_top_k` when the recipe's cells join the channel detail with others; otherwise 0."""
        channels = recipe.parameters.cell_channels()
        return self.detail_only_top_k if DETAIL in channels and len(channels) > 1 else 0


class MapRecipe(Frozen):
    """Description recipe and ranking config of a map."""

    description: DescriptionRecipe
    ranking: RankingConfig
