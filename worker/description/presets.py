"""Named presets, and how a recipe is made of a preset, an encoder and what the user changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from schemas.description import SEMANTIC
from schemas.errors import InvalidParameters, ParameterError, SetupError
from schemas.ports import Encoder
from schemas.recipe import Channel, DenseCells, Dynamic, Graph, Parameters, Recipe, Verification
from worker.description import vocabularies
from worker.description.vocabularies import Vocabulary

PAPER_WORDS = (
    "road", "sidewalk", "building", "vehicle", "car", "bicycle", "motorcycle", "vegetation", "trunk", "terrain",
    "cyclist", "pole", "sky", "other",
)  # fmt: skip
"""The 14 words of the paper (after Semantic-KITTI)."""

PAPER_DYNAMIC = ("vehicle", "car", "bicycle", "motorcycle", "cyclist", "other")
"""The paper's words for things that move."""

CODE_WORDS = (
    "ground", "road", "sidewalk", "parking", "structure", "building", "house", "vehicle", "car", "truck", "van",
    "bicycle", "motorcycle", "nature", "vegetation", "trunk", "terrain", "tree", "human", "person", "cyclist",
    "bicyclist", "motorcyclist", "object", "fence", "pole", "traffic sign", "sky", "other",
)  # fmt: skip
"""The 29 words of the authors' program."""

CODE_DYNAMIC = (
    "vehicle", "car", "truck", "van", "bicycle", "motorcycle", "human", "person", "cyclist", "bicyclist",
    "motorcyclist", "other",
)  # fmt: skip

STREET_AND_ROOM = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "traffic light", "traffic sign", "vegetation", "tree",
    "grass", "terrain", "water", "mountain", "sky", "person", "cyclist", "car", "truck", "bus", "motorcycle", "bicycle",
    "window", "door", "floor", "ceiling", "cabinet", "chair", "table", "sofa", "bed", "stairs", "other",
)  # fmt: skip
"""Words of the default preset: the street outside, the country around it, and the room inside."""

STREET_AND_ROOM_DYNAMIC = ("person", "cyclist", "car", "truck", "bus", "motorcycle", "bicycle")


@dataclass(frozen=True)
class Preset:
    """A named way of describing and ranking.

    Parameters
    ----------
    labels, dynamic : tuple of str
        Words, and those of them that move.
    parameters : Parameters
    """

    labels: tuple[str, ...]
    dynamic: tuple[str, ...]
    parameters: Parameters


_PAPER = Parameters(
    channels={SEMANTIC: Channel(layer=SEMANTIC, words=10, descriptors=1000, normalisation="l1")},
    candidates=20,
    graph=Graph(min_region_cells=1, cosine=0.95, tau=70 / 520),
    ranking="graph",
)

_DEFAULT = Parameters(
    channels={
        SEMANTIC: Channel(layer=SEMANTIC, words=512, assignments=3, temperature=0.05, dimensions=128),
        "detail": Channel(layer="detail", words=512, assignments=3, temperature=0.1, dimensions=128),
    },
    dynamic=Dynamic(margin=0.1, most=0.5),
    candidates=50,
    dense=DenseCells(
        rows=16,
        columns=28,
        dimensions=32,
        shares={SEMANTIC: 0.35, "detail": 0.65},
        full_resolution_top_k=12,
        alone={"detail": 6},
        scale_penalty=0.4,
    ),
    graph=Graph(min_region_cells=8, cosine=0.7, tau=0.3),
    verification=Verification(candidates=10, keypoints=300),
    weights={
        "close": 1.7,
        "dense": 0.2,
        "histogram.words": 0.04,
        "histogram.detail": 0.04,
        "graph": 0.05,
        "verification": 0.2,
    },
)

PRESETS: Mapping[str, Preset] = {
    "default": Preset(STREET_AND_ROOM, STREET_AND_ROOM_DYNAMIC, _DEFAULT),
    "paper": Preset(PAPER_WORDS, PAPER_DYNAMIC, _PAPER),
    "code-words": Preset(CODE_WORDS, CODE_DYNAMIC, _PAPER),
}
"""``paper`` is what the paper states, with the authors' numbers where it is silent; ``code-words`` the same with the
words of their program; ``default`` is what measuring found (docs/evaluation.md)."""


def carried(name: str, encoder: Encoder) -> Preset:
    """A preset as far as an encoder can carry it.

    An encoder without an appearance layer searches and ranks by words alone. One that knows only the paper's words
    labels with those.

    Raises
    ------
    InvalidParameters
        There is no such preset.
    """
    if name not in PRESETS:
        raise InvalidParameters.of("preset", f"{name!r} is not one of {', '.join(PRESETS)}")
    preset = PRESETS[name]
    if encoder.name == "color":
        preset = Preset(PAPER_WORDS, PAPER_DYNAMIC, preset.parameters)
    layers = encoder.layers
    return _with_channels(preset, {c: v for c, v in preset.parameters.channels.items() if v.layer in layers})


def preset_for(name: str, encoder: Encoder) -> Preset:
    """A preset that an encoder can serve at once.

    Where no vocabulary ships for it, the words of its one channel are the label words themselves
    (`vocabularies.of_text`), until the map trains its own.
    """
    preset = carried(name, encoder)
    if vocabularies.shipped(encoder.name, name) is not None:
        return preset
    words = preset.parameters.channels[SEMANTIC]
    own = words.model_copy(update={"words": len(preset.labels), "dimensions": None, "assignments": 1})
    return _with_channels(preset, {SEMANTIC: own}, dense=None)


def _with_channels(preset: Preset, channels: Mapping[str, Channel], **changes: Any) -> Preset:
    """A preset with these channels only, and with weights of the terms that they can give."""
    dense = preset.parameters.dense
    changes = {"dense": None if dense is None else dense.among(channels), **changes}
    parameters = preset.parameters.model_copy(update={"channels": dict(channels), **changes})
    missing = {f"histogram.{name}" for name in preset.parameters.channels.keys() - channels.keys()}
    if parameters.dense is None:
        missing |= {"dense", "close"}
    weights = {term: weight for term, weight in preset.parameters.weights.items() if term not in missing}
    return Preset(preset.labels, preset.dynamic, parameters.model_copy(update={"weights": weights}))


def general_vocabulary(encoder: Encoder, name: str) -> Vocabulary:
    """The vocabulary that a preset starts with: shipped with the encoder, or else its text vectors."""
    found = vocabularies.shipped(encoder.name, name)
    if found is not None:
        return found
    preset = preset_for(name, encoder)
    return vocabularies.of_text(encoder.text_vectors(preset.labels), preset.parameters)


def make_recipe(
    encoder: Encoder,
    preset_name: str,
    *,
    labels: Sequence[str] | None = None,
    dynamic: Sequence[str] | None = None,
    parameters: Mapping[str, Any] | None = None,
    vocabulary: Vocabulary | None = None,
    present: Parameters | None = None,
) -> Recipe:
    """A recipe from a preset and what the user changed of it.

    Parameters
    ----------
    encoder : Encoder
    preset_name : str
    labels, dynamic : sequence of str, optional
        Replace the preset's. Without `dynamic`, those of the preset's dynamic words that are among the labels.
    parameters : mapping, optional
        Merged into the preset's, key by key at every depth.
    vocabulary : Vocabulary, optional
        Instead of the general one.
    present : Parameters, optional
        What `parameters` is merged into, instead of the preset's.

    Raises
    ------
    InvalidParameters
        Lists everything that is wrong at once.
    """
    preset = preset_for(preset_name, encoder)
    words = tuple(preset.labels if labels is None else (word.strip() for word in labels))
    moving = tuple(w for w in preset.dynamic if w in words) if dynamic is None else tuple(w.strip() for w in dynamic)
    errors = _label_errors(words, moving)
    numbers = present or preset.parameters
    if parameters:
        merged = _merge(numbers.model_dump(mode="json"), parameters)
        try:
            numbers = Parameters.model_validate(merged)
        except ValidationError as error:
            errors += [
                ParameterError(".".join(("parameters", *map(str, e["loc"]))), f"{e['msg']}; seen: {e['input']!r}")
                for e in error.errors()
            ]
    errors += [
        ParameterError(f"parameters.channels.{name}.layer", f"{c.layer!r} is not one of {', '.join(encoder.layers)}")
        for name, c in numbers.channels.items()
        if c.layer not in encoder.layers
    ]
    if errors:
        raise InvalidParameters(errors)
    encoder.meanings(words)
    learned = vocabulary or general_vocabulary(encoder, preset_name)
    try:
        learned.check(numbers, encoder.layers)
    except SetupError as error:
        raise InvalidParameters.of("parameters.channels", error.detail) from None
    return Recipe(
        encoder=encoder.name,
        weights=encoder.digest,
        labels=words,
        dynamic=moving,
        preset=preset_name,
        parameters=numbers,
        vocabulary=learned.digest,
    )


def _label_errors(words: Sequence[str], moving: Sequence[str]) -> list[ParameterError]:
    errors = []
    if not 2 <= len(words) <= 255:
        errors.append(ParameterError("labels", f"{len(words)} words; a label set has 2 to 255"))
    if any(not word for word in words):
        errors.append(ParameterError("labels", "a word is empty"))
    twice = sorted({word for word in words if words.count(word) > 1})
    if twice:
        errors.append(ParameterError("labels", f"named twice: {', '.join(twice)}"))
    stray = [word for word in moving if word not in words]
    if stray:
        errors.append(ParameterError("dynamic", f"not among the labels: {', '.join(stray)}"))
    if words and set(words) <= set(moving):
        errors.append(ParameterError("dynamic", "every label is dynamic, so nothing could be recognised"))
    return errors


def _merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = _merge(inner, value) if isinstance(inner, dict) and isinstance(value, Mapping) else value
    return merged
