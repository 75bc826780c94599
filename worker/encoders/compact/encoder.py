"""The built-in encoder: the compact network, its words, and the size at which it looks at pictures."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, takewhile
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from safetensors.numpy import load

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import InvalidParameters, ParameterError, SetupError
from schemas.image import Bytes2D, Image
from schemas.records import Meaning
from worker.method.unit_length import unit

WEIGHTS = Path(__file__).parents[1] / "weights" / "compact.safetensors"

LONGEST = 480
"""Pictures are brought to this many pixels on the longer side: smaller ones too, since the words need the scale."""

MULTIPLE = 32
"""Sides become multiples of the network's deepest stride, so that nothing is padded."""

SEGMENTATION_STRIDE = 4
"""Pixels, along either side, for each cell of the segmentation network."""

DETAIL = "detail"

ENSEMBLE = ("fine", "second", "third")
"""Who reads segmentation network: names in the JSON file, each with its weights and its graph. The later may be missing."""


@dataclass(frozen=True)
class Augmentation:
    """How a reader of segmentation network looks at a picture.

    Parameters
    ----------
    member : int
        Which of READERS.
    scale : float
        How much larger than LONGEST the picture is made.
    mirrored : bool
        Whether its mirror image is looked at.
    weight : float
        How much it counts, for a look as sure as any other.
    """

    member: int
    scale: float
    mirrored: bool
    weight: float = 1.0


AUGMENTATIONS = (
    *(Augmentation(0, 0.75, True), Augmentation(0, 1.25, False)),
    *(Augmentation(1, 1.25, False, 1.4), Augmentation(1, 1.5, True, 1.4)),
    *(Augmentation(2, 1.25, False, 1.4), Augmentation(2, 1.5, True, 1.4)),
)
"""The looks that segmentation network take at a picture."""

CONFIDENCE_POWER = 6
"""Power of a look's sureness that it counts by besides: the later readers know streets better than rooms."""


class Engine(Protocol):
    """Runs the network on pictures of one size, uint8 of shape (n, height, width, 3), sides multiples of MULTIPLE."""

    def fields(self, images: Bytes2D) -> tuple[Floats, Floats]:
        """Words and detail, float32 of shapes (n, height / 8, width / 8, channels), unit length."""
        ...

    def segmentation(self, images: Bytes2D, member: int) -> Floats:
        """Words as one of READERS has them, float32 of shape (n, height / 4, width / 4, channels), unit length."""
        ...


class CompactEncoder:
    """Language-aligned embeddings (layer ``words``) and appearance (layer ``detail``) at one cell per 8 x 8 pixels.

    Parameters
    ----------
    device : str
        ``cpu``: ONNX Runtime; ``cuda``, ...: torch.
    weights : Path
        Beside it lie a JSON file of the same name with its SHA-256 and its words, and the files that this one names:
        graphs, and the segmentation network. Without segmentation network the finest field is that of `encode`.
    threads : int
        Of ONNX Runtime; torch has a setting of its own for the whole process.

    Raises
    ------
    SetupError
        A file is missing or is not the one the JSON file describes, or ONNX Runtime cannot be used.
    """

    name = "compact"

    def __init__(self, device: str = "cpu", weights: Path = WEIGHTS, *, threads: int = 1) -> None:
        described = weights.with_suffix(".json")
        if not described.exists():
            raise SetupError(f"the encoder's file {described.name} is not in {weights.parent}")
        facts = json.loads(described.read_text())
        content = _verified(described, facts["weights"])
        members = [facts[member] for member in takewhile(facts.__contains__, ENSEMBLE)]
        fine = [_verified(described, member["weights"]) for member in members]
        self.digest: str = facts["weights"]["sha256"]
        self._alone = device == "cpu"
        self._engine = _on_cpu(facts, members, described, threads) if self._alone else _on_gpu(content, fine, device)
        self._members = len(members)
        self._vectors: Floats = load(content)["text.vectors"].astype(np.float32)
        self._words = {entry["word"]: (row, entry) for row, entry in enumerate(facts["words"])}
        self.layers: Mapping[str, int] = {layer: facts["channels"][layer] for layer in (SEMANTIC, DETAIL)}

    def encode(self, images: Sequence[Image]) -> Iterator[PixelField]:
        """One field per picture; see `Encoder.encode`.

        On a CPU pictures go through one by one: that is as quick, and the arithmetic of a picture then cannot depend
        on its neighbours. On a GPU, runs of pictures of one size go together.
        """
        if self._alone:
            for image in images:
                yield from self._encode([image])
        else:
            for _, run in groupby(images, key=lambda p: network_size(p.width, p.height)):
                yield from self._encode(list(run))

    def _encode(self, images: Sequence[Image]) -> Iterator[PixelField]:
        fields = self._engine.fields(np.stack([resized(image.pixels) for image in images]))
        for image, words, detail in zip(images, *fields, strict=True):
            yield PixelField({SEMANTIC: words, DETAIL: detail}, image.extent)

    def fine(self, image: Image) -> PixelField:
        """Words alone, per 4 x 4 pixels: the mean of several looks at the picture; see `Encoder.fine`."""
        if not self._members:
            return next(self._encode([image]))

        def look(seen: Bytes2D, member: int) -> Floats:
            words: Floats = self._engine.segmentation(seen[None], member)[0]
            return words

        words = segment_with_ensemble(image.pixels, look, self._vectors, self._members)
        return PixelField({SEMANTIC: words}, image.extent)

    def text_vectors(self, words: Sequence[str]) -> Floats:
        """See `Encoder.text_vectors`."""
        self.meanings(words)
        chosen: Floats = self._vectors[[self._words[word][0] for word in words]]
        return chosen

    def meanings(self, words: Sequence[str]) -> list[Meaning]:
        """See `Encoder.meanings`."""
        unknown = [word for word in words if word not in self._words]
        if unknown:
            known = ", ".join(sorted(self._words))
            raise InvalidParameters(
                [
                    ParameterError("labels", f"{word!r} is not known to the encoder compact; known: {known}")
                    for word in unknown
                ]
            )
        entries = [self._words[word][1] for word in words]
        return [Meaning(entry["word"], tuple(entry["clip"]), bool(entry["trained"])) for entry in entries]


def segment_with_ensemble(
    pixels: Bytes2D,
    look: Callable[[Bytes2D, int], Floats],
    vectors: Floats,
    members: int = len(ENSEMBLE),
    longest: float = LONGEST,
) -> Floats:
    """Give the mean of what is seen of a picture by FINE_LOOKS.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    look
        From such a picture, sides multiples of MULTIPLE, and a reader to float32 of shape (height / 4, width / 4,
        channels).
    vectors : float32 of shape (words, channels)
        Text vectors of the words that there are.
    readers
        How many there are, at least 1; what the others would see is left out.
    longest
        The longer side that the looks' sizes are relative to.

    Returns
    -------
    float32 of shape (rows, columns, channels)
        Unit length; a cell for every 4 x 4 pixels of the picture ``resized`` to `longest`.
    """
    across, down = (side // SEGMENTATION_STRIDE for side in network_size(pixels.shape[1], pixels.shape[0], longest))
    total = np.zeros(())
    for how in AUGMENTATIONS:
        if how.member >= members:
            continue
        seen = resized(pixels, how.scale * longest)
        words = look(np.ascontiguousarray(seen[:, ::-1]) if how.mirrored else seen, how.member)
        words = cv2.resize(words, (across, down), interpolation=cv2.INTER_LINEAR)
        count = how.weight * confidence(words, vectors) ** CONFIDENCE_POWER
        total = total + count * (words[:, ::-1] if how.mirrored else words)
    return unit(total)


def confidence(words: Floats, vectors: Floats) -> float:
    """Say how near to some word the cells of a look are: the mean of their largest cosines, at least a hundredth.

    Parameters
    ----------
    words : float32 of shape (rows, columns, channels)
    vectors : float32 of shape (words, channels)
    """
    nearest = (words.reshape(-1, words.shape[2]) @ vectors.T).max(axis=1)
    return max(float(nearest.mean()), 0.01)


def network_size(width: int, height: int, longest: float = LONGEST) -> tuple[int, int]:
    """(width, height) at which the network sees a picture: longer side about `longest`, both multiples of MULTIPLE."""
    scale = longest / max(width, height)
    across, down = (max(3, round(side * scale / MULTIPLE)) * MULTIPLE for side in (width, height))
    return across, down


def resized(pixels: Bytes2D, longest: float = LONGEST) -> Bytes2D:
    """Bring a picture, uint8 of shape (height, width, 3), to the size at which the network sees it."""
    height, width = pixels.shape[:2]
    size = network_size(width, height, longest)
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size, interpolation=how), np.uint8)


def _on_cpu(facts: Mapping[str, Any], members: Sequence[Mapping[str, Any]], described: Path, threads: int) -> Engine:
    from worker.encoders.compact.onnx import OnnxEngine

    if "graph" not in facts:
        raise SetupError(f"{described.name} names no graph for ONNX Runtime; fetch the repository's own file again")
    graphs = [facts["graph"], *(member["graph"] for member in members)]
    for graph in graphs:
        _verified(described, graph)
    fields, *fine = (described.with_name(graph["file"]) for graph in graphs)
    return OnnxEngine(fields, fine, threads=threads)


def _on_gpu(content: bytes, fine: Sequence[bytes], device: str) -> Engine:
    from worker.encoders.compact.torch import TorchEngine

    return TorchEngine(content, fine, device)


def _verified(described: Path, named: Mapping[str, str]) -> bytes:
    """Read a file whose name and SHA-256 the JSON file `described` gives."""
    path, sha256 = described.with_name(named["file"]), named["sha256"]
    if not path.exists():
        raise SetupError(f"the encoder's file {path.name} is not in {path.parent}")
    content = path.read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise SetupError(
            f"{path.name} has the SHA-256 {found[:16]}..., but {described.name} describes {sha256[:16]}...; "
            "fetch the repository's own file again"
        )
    return content
