"""Vocabularies as files: safetensors with the tensors of all channels, named by the SHA-256 of the bytes."""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from schemas.description import SEMANTIC, Booleans, Floats, PixelField
from schemas.errors import SetupError
from schemas.recipe import Channel, DescriptionParameters
from worker.method import dense_cells, sampling, vocabulary
from worker.method.vocabulary import ChannelVocabulary, Projection

SHIPPED = Path(__file__).parents[1] / "encoders" / "weights"
"""Folder of the general vocabularies, ``ENCODER-PRESET.vocabulary.safetensors``."""

NAMES_IN_FILES = {SEMANTIC: "words"}
"""Names of channels in files, where they differ: recipes name files by their SHA-256, so files keep theirs."""

PER_IMAGE = 200
"""Descriptors drawn per image for training, so that all images count the same."""

KEPT_SIZES = "one that is trained on the map's views has the channels and sizes of the one before"

MOST_IMAGES = 1000
"""Images used for training at most; more only take longer."""


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """The vocabulary of every channel of a recipe."""

    channels: Mapping[str, ChannelVocabulary]

    @cached_property
    def tensors(self) -> bytes:
        """The vocabulary as safetensors bytes; equal vocabularies give equal bytes."""
        named: dict[str, Floats] = {}
        for name, channel in sorted((NAMES_IN_FILES.get(n, n), c) for n, c in self.channels.items()):
            named[f"{name}.words"] = channel.words
            if channel.projection is not None:
                named[f"{name}.mean"] = channel.projection.mean
                named[f"{name}.projection"] = channel.projection.matrix
            if channel.cells is not None:
                named[f"{name}.cells"] = channel.cells
        return save({key: np.ascontiguousarray(value, np.float32) for key, value in named.items()})

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of `tensors`, by which recipes name the vocabulary."""
        return hashlib.sha256(self.tensors).hexdigest()

    @classmethod
    def read(cls, tensors: bytes, source: str) -> "Vocabulary":
        """Read a vocabulary from safetensors bytes; `source` names them in errors.

        Raises
        ------
        SetupError
            The bytes are not a vocabulary.
        """
        try:
            named = load(tensors)
        except SafetensorError as error:
            raise SetupError(f"{source} is no vocabulary: {error}") from None
        channels = {}
        ours = {theirs: name for name, theirs in NAMES_IN_FILES.items()}
        for name in sorted(key.removesuffix(".words") for key in named if key.endswith(".words")):
            mean = named.get(f"{name}.mean")
            projection = None if mean is None else Projection(mean, named[f"{name}.projection"])
            channels[ours.get(name, name)] = ChannelVocabulary(
                named[f"{name}.words"], projection, named.get(f"{name}.cells")
            )
        if not channels:
            raise SetupError(f"{source} is no vocabulary: it has the tensors {sorted(named)}")
        return cls(channels)

    def check(self, parameters: DescriptionParameters, layers: Mapping[str, int]) -> None:
        """Check that this vocabulary fits a recipe's parameters and an encoder's layers.

        Raises
        ------
        SetupError
            Names the first channel whose sizes differ.
        """
        for name, channel in parameters.channels.items():
            learned = self.channels.get(name)
            if learned is None:
                has = sorted(self.channels)
                raise SetupError(f"the vocabulary has no channel {name!r}; it has {has}; {KEPT_SIZES}")
            want = (channel.vocabulary_size, layers[channel.layer])
            if learned.words.shape != want:
                raise SetupError(
                    f"channel {name!r}: the vocabulary has (words, channels) {learned.words.shape}, "
                    f"the recipe wants {want}; {KEPT_SIZES}"
                )
            got = None if learned.projection is None else learned.projection.matrix.shape[1]
            if got != channel.dimensions:
                raise SetupError(
                    f"channel {name!r}: the vocabulary projects to {got}, the recipe to {channel.dimensions}; "
                    f"{KEPT_SIZES}"
                )


def shipped(encoder: str, preset: str) -> Vocabulary | None:
    """The general vocabulary that ships for an encoder and a preset; None where there is none."""
    path = SHIPPED / f"{encoder}-{preset}.vocabulary.safetensors"
    return Vocabulary.read(path.read_bytes(), path.name) if path.exists() else None


def of_text(text_vectors: Floats, parameters: DescriptionParameters) -> Vocabulary:
    """A vocabulary without training: the labels' text vectors are the visual words.

    Every channel must take its descriptors from the layer ``semantic`` and have as many visual words as there are text
    vectors; its histogram then counts labels.
    """
    return Vocabulary({name: ChannelVocabulary(text_vectors) for name in parameters.channels})


StaticCells = Callable[[PixelField], Booleans]


def train(
    fields: Iterable[PixelField], static_cells: StaticCells, parameters: DescriptionParameters, seed: int = 0
) -> Vocabulary:
    """Train the vocabulary of every channel on images (paper, "Visual-Language Vocabulary").

    Parameters
    ----------
    fields : iterable of PixelField
        Of database images only: a vocabulary trained on queries inflates all results. Consumed once; at most
        `MOST_IMAGES` are read.
    static_cells : function
        Field to bool of shape (rows, columns), True for static cells.
    parameters : DescriptionParameters
    seed : int

    Raises
    ------
    ValueError
        Too few images for the number of visual words or dimensions; says which.
    """
    random = np.random.default_rng(seed)
    images: dict[str, list[Floats]] = {name: [] for name in parameters.channels}
    grids: dict[str, list[Floats]] = {name: [] for name in parameters.channels}
    for number, field in enumerate(fields):
        if number == MOST_IMAGES:
            break
        static = static_cells(field)
        for name, channel in parameters.channels.items():
            layer = field.layers[channel.layer]
            drawn = sampling.draw(static, channel.descriptors, random)
            images[name].append(layer.reshape(-1, layer.shape[2])[drawn].astype(np.float16))
            if parameters.dense is not None:
                grid = dense_cells.grid(layer, parameters.dense.rows, parameters.dense.columns)
                grids[name].append(grid.reshape(-1, grid.shape[-1]))
    if not all(images.values()):
        raise ValueError("there is no image to learn from")
    return Vocabulary(
        {
            name: _train_channel(channel, images[name], grids[name], parameters, random)
            for name, channel in parameters.channels.items()
        }
    )


def _train_channel(
    channel: Channel,
    images: Sequence[Floats],
    grids: Sequence[Floats],
    parameters: DescriptionParameters,
    random: np.random.Generator,
) -> ChannelVocabulary:
    sample = np.concatenate([p[random.permutation(len(p))[:PER_IMAGE]] for p in images]).astype(np.float32)
    # Soft assignment compares cosines: spherical k-means. Hard assignment takes the nearest word: plain k-means.
    words = vocabulary.train_words(sample, channel.vocabulary_size, random, spherical=channel.assignments > 1)
    plain = ChannelVocabulary(words)
    projection = None
    if channel.dimensions is not None:
        full = channel.model_copy(update={"dimensions": None})
        histograms = np.stack([vocabulary.vector(p.astype(np.float32), plain, full) for p in images])
        projection = vocabulary.fit_projection(histograms, channel.dimensions)
    cells = None
    if parameters.dense is not None:
        cells = vocabulary.fit_cells(np.concatenate(grids), parameters.dense.dimensions)
    return ChannelVocabulary(words, projection, cells)
