"""What describing needs from outside: an encoder, and optionally a network for segmentations."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from schemas.description import Floats, PixelField
from schemas.image import Image
from schemas.records import Meaning


class Encoder(Protocol):
    """Turns images into fields of language-aligned embeddings. Deterministic on one machine type."""

    @property
    def name(self) -> str:
        """Of the encoder; with `digest` it decides every embedding."""
        ...

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the weights."""
        ...

    @property
    def layers(self) -> Mapping[str, int]:
        """Channels of each layer of its fields; ``semantic`` is always there."""
        ...

    @property
    def known_labels(self) -> frozenset[str] | None:
        """Labels that it has text vectors for; None when it makes one for any label."""
        ...

    def encode(self, images: Sequence[Image]) -> Iterator[PixelField]:
        """One field per image, in order, each independent of the others in the batch."""
        ...

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        """Vectors of labels, float32 (labels, channels of the layer ``semantic``).

        A cell's inner product with one is their cosine. Not longer than 1; shorter by what lies outside the space that
        cells can reach.

        Raises
        ------
        InvalidParameters
            Names each label it does not know, and those it does.
        """
        ...

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        """How each label is understood; raises as `text_vectors`."""
        ...


class Segmenter(Protocol):
    """Sees an image at a finer grid than an encoder, for people to look at; nothing that is stored is made of it."""

    def segment(self, image: Image) -> PixelField:
        """The layer ``semantic`` at the finest grid there is, in the space of the encoder's text vectors."""
        ...


class VocabularyReader(Protocol):
    """Vocabularies that maps have trained."""

    def get(self, digest: str) -> bytes:
        """The safetensors bytes of a vocabulary by their SHA-256; raises NotFound."""
        ...
