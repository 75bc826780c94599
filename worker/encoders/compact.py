"""The built-in encoder: the compact network, its words, and the size at which it looks at pictures."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors.torch import load

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import InvalidParameters, ParameterError, SetupError
from schemas.picture import Bytes2D, Picture
from schemas.records import Meaning
from worker.encoders.compact_network import CompactNetwork

WEIGHTS = Path(__file__).parent / "weights" / "compact.safetensors"

LONGEST = 480
"""Pictures are brought to this many pixels on the longer side: smaller ones too, since the words need the scale."""

MULTIPLE = 32
"""Sides become multiples of the network's deepest stride, so that nothing is padded."""

DETAIL = "detail"


class CompactEncoder:
    """Language-aligned embeddings (layer ``words``) and appearance (layer ``detail``) at one cell per 8 x 8 pixels.

    Parameters
    ----------
    device : str
        ``cpu``, ``cuda``, ...
    weights : Path
        Beside it lies a JSON file of the same name with its SHA-256 and its words.

    Raises
    ------
    SetupError
        The weights are missing, or are not the ones the JSON file describes.
    """

    name = "compact"

    def __init__(self, device: str = "cpu", weights: Path = WEIGHTS) -> None:
        described = weights.with_suffix(".json")
        if not weights.exists() or not described.exists():
            raise SetupError(f"the encoder's weights {weights.name} and {described.name} are not in {weights.parent}")
        content = weights.read_bytes()
        facts = json.loads(described.read_text())
        self.digest = hashlib.sha256(content).hexdigest()
        if self.digest != facts["sha256"]:
            raise SetupError(
                f"{weights.name} has the SHA-256 {self.digest[:16]}..., but {described.name} describes "
                f"{facts['sha256'][:16]}...; fetch the repository's own file again"
            )
        tensors = load(content)
        self._device = torch.device(device)
        network = CompactNetwork.loaded({k: v for k, v in tensors.items() if not k.startswith("text.")})
        self._network = network.to(self._device)
        self._vectors: Floats = tensors["text.vectors"].float().numpy()
        self._words = {entry["word"]: (row, entry) for row, entry in enumerate(facts["words"])}
        self.layers: Mapping[str, int] = {layer: facts["channels"][layer] for layer in (SEMANTIC, DETAIL)}

    def encode(self, pictures: Sequence[Picture]) -> Iterator[PixelField]:
        """One field per picture; see `Encoder.encode`.

        On a CPU pictures go through one by one: that is as quick, and the arithmetic of a picture then cannot depend
        on its neighbours. On a GPU, runs of pictures of one size go together.
        """
        if self._device.type == "cpu":
            for picture in pictures:
                yield from self._encode([picture])
        else:
            for _, run in groupby(pictures, key=lambda p: network_size(p.width, p.height)):
                yield from self._encode(list(run))

    def _encode(self, pictures: Sequence[Picture]) -> Iterator[PixelField]:
        resized = np.stack([_resized(picture) for picture in pictures])
        with torch.inference_mode():
            batch = torch.from_numpy(resized).to(self._device).permute(0, 3, 1, 2)
            words, detail = self._network((batch.float() / 255).contiguous(memory_format=torch.channels_last))
            fields = [layer.permute(0, 2, 3, 1).contiguous().float().cpu().numpy() for layer in (words, detail)]
        for picture, semantic, appearance in zip(pictures, *fields, strict=True):
            yield PixelField({SEMANTIC: semantic, DETAIL: appearance}, picture.extent)

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


def network_size(width: int, height: int) -> tuple[int, int]:
    """(width, height) at which the network sees a picture: longer side LONGEST, both multiples of MULTIPLE."""
    scale = LONGEST / max(width, height)
    across, down = (max(3, round(side * scale / MULTIPLE)) * MULTIPLE for side in (width, height))
    return across, down


def _resized(picture: Picture) -> Bytes2D:
    size = network_size(picture.width, picture.height)
    shrinks = size[0] < picture.width
    pixels: Bytes2D = cv2.resize(picture.pixels, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return pixels
