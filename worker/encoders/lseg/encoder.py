"""The encoder port, kept by LSeg."""

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, Self

import numpy as np
import torch
from torch import Tensor

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import InvalidParameters, ParameterError, SetupError
from schemas.image import Image
from schemas.records import Meaning
from worker.encoders.lseg.checkpoint import load
from worker.encoders.lseg.config import PUBLISHED, Config
from worker.encoders.lseg.network import Network
from worker.encoders.lseg.tokenizer import Tokenizer, TooLong
from worker.encoders.lseg.windows import Covering, Input, Single, Windows

Mode = Literal["windows", "single"]

BATCH_ON_GPU = 8


class LsegEncoder:
    """LSeg's pixel embeddings and CLIP's text vectors.

    Parameters
    ----------
    network : Network
        In float32, on the CPU.
    tokenizer : Tokenizer
    digest : str
        Of the weights' values. That of the encoder is of these and of the mode ``single``, whose embeddings differ.
    mode : {"windows", "single"}
        How an image is covered; see `worker.encoders.lseg.windows`.
    device : str
        Where the image network runs. The text tower stays on the CPU in float32, so that a label's vector is the same
        whatever runs the network.
    dtype : torch.dtype or None
        Of the image network; None: float32 on a CPU; on a GPU bfloat16, which cannot overflow, or float16
        where the GPU has no bfloat16.
    batch : int
        Inputs (windows) that go through the network together; 0: 1 on a CPU, 8 on a GPU. Fewer than this are filled
        up: which product routine is taken, and so how sums round, depends on the shape of a batch, and an image's
        embeddings must not depend on what came with it.

    Raises
    ------
    SetupError
        There is no such device.
    """

    name = "lseg"
    terms = "those of the checkpoint that REVISIT_WEIGHTS names: see docs/lseg.md"
    known_labels = None  # any label has a vector: the text network makes it

    def __init__(
        self,
        network: Network,
        tokenizer: Tokenizer,
        digest: str,
        *,
        mode: Mode = "windows",
        device: str = "cpu",
        dtype: torch.dtype | None = None,
        batch: int = 0,
    ) -> None:
        self._device = usable_device(device)
        on_cpu = self._device.type == "cpu"
        self._dtype = dtype or (torch.float32 if on_cpu else half_precision())
        self._batch = batch or (1 if on_cpu else BATCH_ON_GPU)
        self._network, self._tokenizer = network, tokenizer
        self.digest = digest if mode == "windows" else hashlib.sha256(f"{digest}:{mode}".encode()).hexdigest()
        self.layers: Mapping[str, int] = {SEMANTIC: network.config.channels}
        for part in (network.pretrained, network.scratch):
            part.to(self._device, self._dtype)
        self._covering: Covering = Windows(network.config) if mode == "windows" else Single(network.config)

    @classmethod
    def open(
        cls,
        weights: Path | None,
        *,
        vocabulary: Path | None = None,
        mode: Mode = "windows",
        device: str = "cpu",
        dtype: torch.dtype | None = None,
        batch: int = 0,
        config: Config = PUBLISHED,
    ) -> Self:
        """The encoder with its weights read from a file.

        Parameters
        ----------
        weights : Path or None
            ``demo_e200.ckpt``, or what `convert` made of it. There is no default: None is refused.
        vocabulary : Path or None
            CLIP's; None takes it from an installed package.
        mode, device, dtype, batch
            As for the class.
        config : Config

        Raises
        ------
        SetupError
            Says what is missing or wrong, and what was expected.
        """
        if weights is None:
            raise SetupError(
                "the encoder lseg needs REVISIT_WEIGHTS=.../demo_e200.ckpt; docs/lseg.md says where it comes from"
            )
        usable_device(device)
        tokenizer = Tokenizer.read(vocabulary, config.context)
        network, digest = load(weights, config)
        return cls(network, tokenizer, digest, mode=mode, device=device, dtype=dtype, batch=batch)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """One field per image, in order, each computed on demand.

        In mode ``windows`` the longer side has 520 cells and a field takes up to 554 MB: reduce one before taking the
        next. In mode ``single`` it has half as many.
        """
        raw = self.raw(images)
        for image in images:
            # No name is bound to a field here: it would keep half a gigabyte alive while the next one is made.
            yield PixelField({SEMANTIC: unit_length(next(raw))}, image.extent)

    def raw(self, images: Sequence[Image]) -> Iterator[Tensor]:
        """Embeddings as the reference returns them.

        Returns
        -------
        iterator of float32 of shape (rows, columns, channels)
            On the encoder's device; of lengths up to 14.29, less where windows that disagree were averaged.
        """
        inputs = (i for image in images for i in self._covering.inputs(image.pixels))
        outputs = self._outputs(inputs)
        for image in images:
            yield self._covering.join((image.height, image.width), outputs)

    def _outputs(self, inputs: Iterable[Input]) -> Iterator[Tensor]:
        """The network's output for each input; neighbours of one shape go through it together."""
        for _, alike in itertools.groupby(inputs, key=lambda i: i.pixels.shape):
            while batch := list(itertools.islice(alike, self._batch)):
                yield from self._forward(batch)

    @torch.inference_mode()
    def _forward(self, batch: list[Input]) -> list[Tensor]:
        """One pass of the network."""
        filled = batch + batch[-1:] * (self._batch - len(batch))
        pixels = torch.stack([i.pixels for i in filled])
        pixels = pixels.to(self._device, self._dtype, memory_format=torch.channels_last)
        # A batch of several is computed whole: its shape must not depend on how much of each window is padding.
        keep = batch[0].keep if self._batch == 1 else None
        return list(self._network(pixels, keep)[: len(batch)])

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        """Unit-length vectors of labels, float32 of shape (labels, channels).

        Labels enter the text tower bare, without a sentence around them, as in LSeg.

        Raises
        ------
        InvalidParameters
            Names each label that is empty, or longer than the text tower's context.
        """
        ids = self._ids(labels)
        if not ids:
            return np.zeros((0, self.layers[SEMANTIC]), np.float32)
        with torch.inference_mode():
            vectors: Floats = self._network.clip_pretrained(ids).numpy()
        return vectors

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        """Every label stands for itself: the text tower reads any text. None is known to have been trained on.

        The published checkpoint does not say which labels its pixels carried; see docs/lseg.md.
        """
        self._ids(labels)
        return [Meaning(label, (label,), trained=False) for label in labels]

    def _ids(self, labels: Sequence[str]) -> list[list[int]]:
        """Token ids of labels; InvalidParameters names every unusable label."""
        ids, errors = [], []
        for index, label in enumerate(labels):
            try:
                ids.append(self._tokenizer.encode(label))
            except TooLong as error:
                errors.append(ParameterError(f"labels[{index}]", f"{label[:40]!r}... is too long: {error}"))
                continue
            if len(ids[-1]) == 2:
                errors.append(ParameterError(f"labels[{index}]", f"{label!r} is empty; expected a label"))
        if errors:
            raise InvalidParameters(errors)
        return ids


def half_precision() -> torch.dtype:
    """What this machine's GPU computes fastest in without running out of range."""
    return torch.bfloat16 if torch.cuda.is_bf16_supported(including_emulation=False) else torch.float16


def unit_length(raw: Tensor) -> Floats:
    """Vectors (rows, columns, channels) scaled to length 1, in place."""
    with torch.inference_mode():
        raw.div_(torch.linalg.vector_norm(raw, dim=-1, keepdim=True))
        return raw.cpu().numpy()


def usable_device(name: str) -> torch.device:
    """A device of this machine.

    Raises
    ------
    SetupError
        There is none of this name.
    """
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).strip().splitlines()[0]
        raise SetupError(f"REVISIT_DEVICE={name}: {reason}; use cpu, or cuda with a CUDA build of PyTorch") from None
    return device
