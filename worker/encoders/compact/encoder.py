"""The built-in encoders: the compact network and the labels it knows, with one of the weights that ship."""

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
from worker.encoders.compact.engine import Engine, on_cpu, on_gpu, verified
from worker.encoders.compact.ensemble import ENSEMBLE, CompactSegmenter, digest_of
from worker.encoders.compact.input_size import network_size, resized

WEIGHTS = Path(__file__).parents[1] / "weights" / "compact.safetensors"


def weights_named(encoder: str) -> Path:
    """File of the weights that ship as an encoder of this name."""
    return WEIGHTS.with_stem(encoder)


class CompactEncoder:
    """Language-aligned embeddings (layer ``semantic``) and appearance (layer ``detail``) at one cell per 8 x 8 pixels.

    Parameters
    ----------
    device : str
        ``cpu``: ONNX Runtime; ``cuda``, ...: torch.
    weights : Path
        Safetensors file, whose name is the encoder's. Beside it lies a JSON file of the same name with its SHA-256, its
        labels, the terms of its use, and the names of the other files: graphs for ONNX Runtime, and the members of the
        segmentation ensemble, if it has one.
    threads : int
        Threads of ONNX Runtime; those of torch are set for the whole process.
    encodes, segments : bool
        Whether the networks of fields and of segmentations are loaded. An instance with neither knows labels alone, and
        needs no library that runs a network.
    prepared : bool
        Whether images come as the network gets them, of sizes as from `input_size.network_size`, from nodes that share
        this encoder.

    Raises
    ------
    SetupError
        A file is missing or does not have the SHA-256 of the JSON file, or ONNX Runtime cannot be used.
    """

    def __init__(
        self,
        device: str = "cpu",
        weights: Path = WEIGHTS,
        *,
        threads: int = 1,
        encodes: bool = True,
        segments: bool = True,
        prepared: bool = False,
    ) -> None:
        described = weights.with_suffix(".json")
        if not described.exists():
            raise SetupError(f"the encoder's file {described.name} is not in {weights.parent}")
        facts = json.loads(described.read_text())
        content = verified(described, facts["weights"])
        known = [facts[member] for member in takewhile(facts.__contains__, ENSEMBLE)]
        members = known if segments else []
        fine = [verified(described, member["weights"]) for member in members]
        self.name = weights.stem
        self.digest: str = facts["weights"]["sha256"]
        self.terms: str = facts["terms"]
        self.members = len(known)
        """Of the segmentation ensemble, loaded or not."""
        self.segmenter_digest = digest_of([self.digest, *(member["weights"]["sha256"] for member in known)])
        self._one_by_one, self._prepared = device == "cpu", prepared
        self._engine: Engine | None = None
        if encodes or members:
            self._engine = (
                on_cpu(facts, members, described, threads, encodes)
                if self._one_by_one
                else on_gpu(content, fine, device)
            )
        self._segments = bool(members)
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
        if self._engine is None:
            raise SetupError("this encoder knows labels alone: its fields come from a shared encoder")
        fields = self._engine.fields(np.stack(pixels))
        for image, semantic, detail in zip(images, *fields, strict=True):
            yield PixelField({SEMANTIC: semantic, DETAIL: detail}, image.extent)

    def segmenter(self) -> CompactSegmenter | None:
        """The segmentation ensemble; None without its weights."""
        if self._engine is None or not self._segments:
            return None
        return CompactSegmenter(self._engine, self._vectors, self.members, self.segmenter_digest)

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
                    ParameterError("labels", f"{label!r} is not known to the encoder {self.name}; known: {known}")
                    for label in unknown
                ]
            )
        entries = [self._labels[label][1] for label in labels]
        return [Meaning(entry["word"], tuple(entry["clip"]), bool(entry["trained"])) for entry in entries]
