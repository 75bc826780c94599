"""Named presets, and map recipes built from a preset, an encoder and the user's changes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from schemas.description import DETAIL, SEMANTIC
from schemas.errors import InvalidParameters, ParameterError, SetupError
from schemas.recipe import (
    CellGrid,
    Channel,
    DescriptionParameters,
    DescriptionRecipe,
    DynamicFilter,
    GraphNodes,
    MapRecipe,
    RankingConfig,
    TermWeights,
)
from worker.description import vocabularies
from worker.description.ports import Encoder
from worker.description.vocabularies import Vocabulary

PAPER_LABELS = (
    "road", "sidewalk", "building", "vehicle", "car", "bicycle", "motorcycle", "vegetation", "trunk", "terrain",
    "cyclist", "pole", "sky", "other",
)  # fmt: skip
"""The 14 labels of the paper (after Semantic-KITTI)."""

PAPER_DYNAMIC = ("vehicle", "car", "bicycle", "motorcycle", "cyclist", "other")
"""The paper's dynamic labels."""

CODE_LABELS = (
    "ground", "road", "sidewalk", "parking", "structure", "building", "house", "vehicle", "car", "truck", "van",
    "bicycle", "motorcycle", "nature", "vegetation", "trunk", "terrain", "tree", "human", "person", "cyclist",
    "bicyclist", "motorcyclist", "object", "fence", "pole", "traffic sign", "sky", "other",
)  # fmt: skip
"""The 29 labels of the authors' program."""

CODE_DYNAMIC = (
    "vehicle", "car", "truck", "van", "bicycle", "motorcycle", "human", "person", "cyclist", "bicyclist",
    "motorcyclist", "other",
)  # fmt: skip

STREET_AND_ROOM = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "traffic light", "traffic sign", "vegetation", "tree",
    "grass", "terrain", "water", "mountain", "sky", "person", "cyclist", "car", "truck", "bus", "motorcycle", "bicycle",
    "window", "door", "floor", "ceiling", "cabinet", "chair", "table", "sofa", "bed", "stairs", "other",
)  # fmt: skip
"""Labels of the default preset: streets, countryside and rooms."""

STREET_AND_ROOM_DYNAMIC = ("person", "cyclist", "car", "truck", "bus", "motorcycle", "bicycle")


@dataclass(frozen=True)
class Preset:
    """Labels, description parameters and ranking under one name.

    Parameters
    ----------
    labels, dynamic : tuple of str
        All labels, and the dynamic ones among them.
    parameters : DescriptionParameters
    ranking : RankingConfig
    """

    labels: tuple[str, ...]
    dynamic: tuple[str, ...]
    parameters: DescriptionParameters
    ranking: RankingConfig


_PAPER = DescriptionParameters(
    channels={SEMANTIC: Channel(layer=SEMANTIC, vocabulary_size=10, descriptors=1000, normalisation="l1")},
    graph=GraphNodes(min_region_cells=1),
)

_PAPER_RANKING = RankingConfig(
    preset="paper",
    mode="graph",
    candidates=20,
    weights=TermWeights(graph=1.0),
    full_resolution_top_k=0,
    graph_cosine=0.95,
    graph_max_edge=70 / 520,
    verified_top_k=0,
)

_DEFAULT = DescriptionParameters(
    channels={
        SEMANTIC: Channel(layer=SEMANTIC, vocabulary_size=512, assignments=3, temperature=0.05, dimensions=128),
        DETAIL: Channel(layer=DETAIL, vocabulary_size=512, assignments=3, temperature=0.1, dimensions=128),
    },
    dynamic=DynamicFilter(margin=0.1, most=0.5),
    dense=CellGrid(rows=16, columns=28, dimensions=32, channel_weights={SEMANTIC: 0.35, DETAIL: 0.65}),
    graph=GraphNodes(min_region_cells=8),
    local_features=300,
    local_features_equalised=False,
)

_DEFAULT_RANKING = RankingConfig(
    preset="default",
    mode="weighted",
    candidates=50,
    shortlist_from=250,
    shortlist_looked=1000,
    shortlist_kept=200,
    weights=TermWeights(
        dense_full=1.7, dense=0.2, histogram={SEMANTIC: 0.04, DETAIL: 0.04}, graph=0.05, verification=0.4
    ),
    full_resolution_top_k=12,
    detail_only_top_k=6,
    scale_penalty=0.4,
    graph_cosine=0.7,
    graph_max_edge=0.3,
    verified_top_k=10,
)

PRESETS: Mapping[str, Preset] = {
    "default": Preset(STREET_AND_ROOM, STREET_AND_ROOM_DYNAMIC, _DEFAULT, _DEFAULT_RANKING),
    "paper": Preset(PAPER_LABELS, PAPER_DYNAMIC, _PAPER, _PAPER_RANKING),
    "code-words": Preset(CODE_LABELS, CODE_DYNAMIC, _PAPER, _PAPER_RANKING.model_copy(update={"preset": "code-words"})),
}
"""``paper`` has the paper's values, and the authors' program's where the paper gives none; ``code-words`` the same with
the labels of their program; ``default`` was tuned by measurement (docs/evaluation.md)."""


def preset_for(name: str, encoder: Encoder) -> Preset:
    """A preset that an encoder can use without training.

    Where no vocabulary ships for both, the preset has one channel, whose visual words are the labels' text vectors
    (`vocabularies.of_text`).

    Raises
    ------
    InvalidParameters
        There is no such preset.
    """
    preset = adapted(name, encoder)
    if vocabularies.shipped(encoder.name, name) is not None:
        return preset
    words = preset.parameters.channels[SEMANTIC]
    own = words.model_copy(update={"vocabulary_size": len(preset.labels), "dimensions": None, "assignments": 1})
    return _with_channels(
        replace(preset, parameters=preset.parameters.model_copy(update={"dense": None})), {SEMANTIC: own}
    )


def adapted(name: str, encoder: Encoder) -> Preset:
    """A preset adapted to the layers and labels of an encoder; raises InvalidParameters for an unknown name.

    An encoder without the layer ``detail`` searches and ranks by the semantic channel alone. One that does not know all
    of the preset's labels gets the paper's.
    """
    if name not in PRESETS:
        raise InvalidParameters.of("preset", f"{name!r} is not one of {', '.join(PRESETS)}")
    preset = PRESETS[name]
    known = encoder.known_labels
    if known is not None and not known.issuperset(preset.labels):
        preset = replace(preset, labels=PAPER_LABELS, dynamic=PAPER_DYNAMIC)
    layers = encoder.layers
    return _with_channels(preset, {c: v for c, v in preset.parameters.channels.items() if v.layer in layers})


def _with_channels(preset: Preset, channels: Mapping[str, Channel]) -> Preset:
    """A preset with these channels only, without weights of terms that need others."""
    parameters, weights = preset.parameters, preset.ranking.weights
    dense = parameters.dense
    if dense is not None:
        kept = {name: weight for name, weight in dense.channel_weights.items() if name in channels}
        dense = dense.model_copy(update={"channel_weights": kept})
    changes: dict[str, Any] = {"histogram": {c: w for c, w in weights.histogram.items() if c in channels}}
    if dense is None:
        changes |= {"dense_full": 0.0, "dense": 0.0}
    ranking: dict[str, Any] = {"weights": weights.model_copy(update=changes)}
    if len(channels) == 1:
        ranking["detail_only_top_k"] = 0
    return replace(
        preset,
        parameters=parameters.model_copy(update={"channels": dict(channels), "dense": dense}),
        ranking=preset.ranking.model_copy(update=ranking),
    )


def general_vocabulary(encoder: Encoder, name: str) -> Vocabulary:
    """The vocabulary of a preset before training: shipped with the encoder, or else its text vectors."""
    found = vocabularies.shipped(encoder.name, name)
    if found is not None:
        return found
    preset = preset_for(name, encoder)
    return vocabularies.of_text(encoder.text_vectors(preset.labels), preset.parameters)


@dataclass(frozen=True)
class Wanted:
    """A user's changes to a recipe; None changes nothing.

    Parameters
    ----------
    labels, dynamic : sequence of str, optional
        Replace the preset's. Without `dynamic`, the preset's dynamic labels that are among the labels.
    preset : str, optional
    parameters, ranking : mapping, optional
        Merged into the preset's, key by key at every depth.
    """

    labels: Sequence[str] | None = None
    dynamic: Sequence[str] | None = None
    preset: str | None = None
    parameters: Mapping[str, Any] | None = None
    ranking: Mapping[str, Any] | None = None


def make_recipe(
    encoder: Encoder,
    wanted: Wanted,
    *,
    preset: str,
    present: MapRecipe | None = None,
    vocabulary: Vocabulary | None = None,
) -> MapRecipe:
    """A map recipe from a preset and the user's changes.

    Parameters
    ----------
    encoder : Encoder
    wanted : Wanted
    preset : str
        Name of the preset when `wanted` has none.
    present : MapRecipe, optional
        The map's recipe: where `wanted` names no preset its parameters are changed instead of the preset's.
    vocabulary : Vocabulary, optional
        Used instead of the general vocabulary.

    Raises
    ------
    InvalidParameters
        Lists all invalid parameters.
    """
    name = wanted.preset or preset
    base = preset_for(name, encoder)
    if present is not None and wanted.preset is None:
        base = Preset(base.labels, base.dynamic, present.description.parameters, present.ranking)
    labels = tuple(base.labels if wanted.labels is None else (label.strip() for label in wanted.labels))
    moving = base.dynamic if wanted.dynamic is None else tuple(label.strip() for label in wanted.dynamic)
    dynamic = tuple(label for label in moving if wanted.dynamic is not None or label in labels)
    errors = _label_errors(labels, dynamic)
    numbers = _merged(DescriptionParameters, base.parameters, wanted.parameters, "parameters", errors)
    ranking = _merged(RankingConfig, base.ranking, wanted.ranking, "ranking", errors)
    errors += [
        ParameterError(f"parameters.channels.{c}.layer", f"{v.layer!r} is not one of {', '.join(encoder.layers)}")
        for c, v in numbers.channels.items()
        if v.layer not in encoder.layers
    ]
    errors += ranking_errors(ranking, numbers, wanted.ranking or {})
    if errors:
        raise InvalidParameters(errors)
    encoder.meanings(labels)
    learned = vocabulary or general_vocabulary(encoder, name)
    try:
        learned.check(numbers, encoder.layers)
    except SetupError as error:
        raise InvalidParameters.of("parameters.channels", error.detail) from None
    description = DescriptionRecipe(
        encoder=encoder.name,
        weights=encoder.digest,
        labels=labels,
        dynamic=dynamic,
        parameters=numbers,
        vocabulary=learned.digest,
    )
    return MapRecipe(description=description, ranking=ranking.model_copy(update={"preset": name}))


def changed_ranking(present: MapRecipe, changes: Mapping[str, Any]) -> RankingConfig:
    """A map's ranking with changed parameters; raises InvalidParameters, which lists all invalid ones."""
    errors: list[ParameterError] = []
    ranking = _merged(RankingConfig, present.ranking, changes, "ranking", errors)
    errors += ranking_errors(ranking, present.description.parameters, changes)
    if errors:
        raise InvalidParameters(errors)
    return ranking


def ranking_errors(
    ranking: RankingConfig, parameters: DescriptionParameters, changes: Mapping[str, Any]
) -> list[ParameterError]:
    """Errors of a ranking that needs more than the descriptions have."""
    errors = []
    if "preset" in changes:
        errors.append(ParameterError("ranking.preset", "is set by `preset`, beside `ranking`"))
    unknown = sorted(ranking.weights.histogram.keys() - parameters.channels.keys())
    if unknown:
        known = ", ".join(parameters.channels)
        detail = f"{', '.join(unknown)} are not among the channels {known}"
        errors.append(ParameterError("ranking.weights.histogram", detail))
    channels = parameters.cell_channels()
    if changes.get("detail_only_top_k") and not (DETAIL in channels and len(channels) > 1):
        detail = (
            f"needs dense cells that join {DETAIL!r} with another channel; these join {', '.join(channels) or 'none'}"
        )
        errors.append(ParameterError("ranking.detail_only_top_k", detail))
    return errors


Half = TypeVar("Half", DescriptionParameters, RankingConfig)


def _merged(
    model: type[Half], base: Half, changes: Mapping[str, Any] | None, name: str, errors: list[ParameterError]
) -> Half:
    """`base` with changes; invalid ones are added to `errors`, and `base` is returned."""
    if not changes:
        return base
    try:
        # Strictly, as JSON: true is no number, and neither is the text "5".
        return model.model_validate_json(json.dumps(_merge(base.model_dump(mode="json"), changes)), strict=True)
    except ValidationError as error:
        errors += _listed(error, model, name)
        return base


def _listed(error: ValidationError, model: type[BaseModel], name: str) -> list[ParameterError]:
    """A validation error as parameter errors; a parameter of the other half is named as such."""
    other: type[BaseModel] = RankingConfig if model is DescriptionParameters else DescriptionParameters
    listed = []
    for one in error.errors():
        detail = f"{one['msg'].removeprefix('Value error, ')} (got {_shown(one['input'])})"
        if one["type"] == "extra_forbidden":
            detail = "is unknown"
            if len(one["loc"]) == 1:
                detail = f"is unknown; known are {', '.join(model.model_fields)}"
                if one["loc"][0] == "preset":
                    detail = f"is set by `preset`, beside `{name}`"
                elif one["loc"][0] in other.model_fields:
                    detail = f"belongs to `{'ranking' if name == 'parameters' else 'parameters'}`, not to `{name}`"
        listed.append(ParameterError(".".join((name, *map(str, one["loc"]))), detail))
    return listed


def _shown(value: object) -> str:
    """A value as it was seen, cut where it is long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


def _label_errors(labels: Sequence[str], dynamic: Sequence[str]) -> list[ParameterError]:
    errors = []
    if not 2 <= len(labels) <= 255:
        errors.append(ParameterError("labels", f"{len(labels)} labels; a label set has 2 to 255"))
    if any(not label for label in labels):
        errors.append(ParameterError("labels", "a label is empty"))
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        errors.append(ParameterError("labels", f"named twice: {', '.join(twice)}"))
    unknown = [label for label in dynamic if label not in labels]
    if unknown:
        errors.append(ParameterError("dynamic", f"not among the labels: {', '.join(unknown)}"))
    if labels and set(labels) <= set(dynamic):
        errors.append(ParameterError("dynamic", "every label is dynamic, so nothing could be recognised"))
    return errors


def _merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = _merge(inner, value) if isinstance(inner, dict) and isinstance(value, Mapping) else value
    return merged
