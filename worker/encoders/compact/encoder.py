"""The built-in encoder: the compact network and the labels it knows."""

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, takewhile
from pathlib import Path

import numpy as np
from safetensors.numpy import load

from schemas.description import DETAIL, SEMANTIC, Floats, PixelField
from schemas.errors import InvalidParameters, ParameterError, SetupError
from schemas.image import Image
from schemas.records import Meaning
from worker.encoders.compact.engine import on_cpu, on_gpu, verified
from worker.encoders.compact.ensemble import ENSEMBLE, CompactSegmenter
from worker.encoders.compact.input_size import network_size, resized

WEIGHTS = Path(__file__).parents[1] / "weights" / "compact.safetensors"


class CompactEncoder:
    """Language-aligned embeddings (layer ``semantic``) and appearance (layer ``detail``) at one cell per 8 x 8 pixels.

    Parameters
    ----------
    device : str
        ``cpu``: ONNX Runtime; ``cuda``, ...: torch.
    weights : Path
        Safetensors file. Beside it lies a JSON file of the same name with its SHA-256, its labels, and the names of the
        other files: graphs for ONNX Runtime, and the members of the segmentation ensemble.
    threads : int
        Threads of ONNX Runtime; those of torch are set for the whole process.
    encodes : bool
        False for an instance that only knows labels and segments: the graph of its fields is not loaded then.
    prepared : bool
        Whether images come as the network gets them, of sizes as from `input_size.network_size`, from nodes that share
        this encoder. It then has no segmenter.

    Raises
    ------
    SetupError
        A file is missing or does not have the SHA-256 of the JSON file, or ONNX Runtime cannot be used.
    """

    name = "compact"

    def __init__(
        self,
        device: str = "cpu",
        weights: Path = WEIGHTS,
        *,
        threads: int = 1,
        encodes: bool = True,
        prepared: bool = False,
    ) -> None:
        described = weights.with_suffix(".json")
        if not described.exists():
            raise SetupError(f"the encoder's file {described.name} is not in {weights.parent}")
        facts = json.loads(described.read_text())
        content = verified(described, facts["weights"])
        members = [] if prepared else [facts[member] for member in takewhile(facts.__contains__, ENSEMBLE)]
        fine = [verified(described, member["weights"]) for member in members]
        self.digest: str = facts["weights"]["sha256"]
        self._one_by_one, self._prepared = device == "cpu", prepared
        self._engine = (
            on_cpu(facts, members, described, threads, encodes) if self._one_by_one else on_gpu(content, fine, device)
        )
        self._members = len(members)
        self._vectors: Floats = load(content)["text.vectors"].astype(np.float32)
        self._labels = {entry["word"]: (row, entry) for row, entry in enumerate(facts["words"])}
        self.known_labels: frozenset[str] | None = frozenset(self._labels)
        channels = facts["channels"]  # the file calls the layer semantic "words"
        self.layers: Mapping[str, int] = {SEMANTIC: channels["words"], DETAIL: channels["detail"]}

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """One field per image; see `Encoder.encode`.

        On a CPU images are encoded one by one: that is as quick, and the result of an image then cannot depend on
        others in the batch. On a GPU, consecutive images of one size form a batch.
        """
        for _, run in groupby(images, key=self._size):
            alike = list(run)
            for together in [[image] for image in alike] if self._one_by_one else [alike]:
                yield from self._encode(together)

    def _size(self, image: Image) -> tuple[int, int]:
        """Width and height of the network's input for an image."""
        return (image.width, image.height) if self._prepared else network_size(image.width, image.height)

    def _encode(self, images: Sequence[Image]) -> Iterator[PixelField]:
        pixels = [image.pixels if self._prepared else resized(image.pixels) for image in images]
        fields = self._engine.fields(np.stack(pixels))
        for image, semantic, detail in zip(images, *fields, strict=True):
            yield PixelField({SEMANTIC: semantic, DETAIL: detail}, image.extent)

    def segmenter(self) -> CompactSegmenter | None:
        """The segmentation ensemble; None without its weights."""
        return CompactSegmenter(self._engine, self._vectors, self._members) if self._members else None

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        """See `Encoder.text_vectors`."""
        self.meanings(labels)
        chosen: Floats = self._vectors[[self._labels[label][0] for label in labels]]
        return chosen

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        """See `Encoder.meanings`."""
        unknown = [label for label in labels if label not in self._labels]
        if unknown:
            known = ", ".join(sorted(self._labels))
            raise InvalidParameters(
                [
                    ParameterError("labels", f"{label!r} is not known to the encoder compact; known: {known}")
                    for label in unknown
                ]
            )
        entries = [self._labels[label][1] for label in labels]
        return [Meaning(entry["word"], tuple(entry["clip"]), bool(entry["trained"])) for entry in entries]
