"""Ports of describing: an encoder, optionally a segmenter, and trained vocabularies."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from schemas.description import Floats, PixelField
from schemas.image import Image
from schemas.records import Meaning


class Encodes(Protocol):
    """Turns images into pixel fields."""

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """One field per image, in order, each independent of the others in the batch.

        Parameters
        ----------
        images : sequence of Image
        urgent : bool
            Whether somebody waits for the answer, as for a query: where others send images too, these go first.

        Raises
        ------
        EncoderAway
            From a shared encoder: it cannot be had now.
        """
        ...


class Encoder(Encodes, Protocol):
    """Turns images into pixel fields of language-aligned embeddings. Deterministic on one machine type."""

    @property
    def name(self) -> str:
        """Name of the encoder; with `digest` it identifies every embedding."""
        ...

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the weights."""
        ...

    @property
    def terms(self) -> str:
        """Terms of use of the weights, in words."""
        ...

    @property
    def layers(self) -> Mapping[str, int]:
        """Number of channels by layer of its fields; ``semantic`` is always among them."""
        ...

    @property
    def known_labels(self) -> frozenset[str] | None:
        """Labels with a text vector; None when it computes one for any label."""
        ...

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        """Text vectors of labels, float32 of shape (labels, channels of the layer ``semantic``).

        The inner product of a cell and a text vector is their cosine. Length at most 1: vectors are projected onto the
        subspace that cells can reach.

        Raises
        ------
        InvalidParameters
            Names each unknown label, and the known ones.
        """
        ...

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        """How each label is understood; raises as `text_vectors`."""
        ...


class Segmenter(Protocol):
    """Segments an image on a finer grid than an encoder, for drawings and blurring; nothing of it is stored."""

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        """A field with the layer ``semantic`` on the finer grid, in the space of the encoder's text vectors.

        `urgent` as in `Encoder.encode`.

        Raises
        ------
        EncoderAway
            From a shared encoder: it cannot be had now.
        """
        ...


class VocabularyReader(Protocol):
    """Vocabularies that were trained on maps."""

    def get(self, digest: str) -> bytes:
        """The safetensors bytes of a vocabulary by their SHA-256; raises NotFound."""
        ...
