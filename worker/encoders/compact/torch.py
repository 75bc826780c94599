"""The compact network in torch, for GPUs and as the reference for ONNX Runtime."""

from collections.abc import Callable, Sequence

import torch
from safetensors.torch import load
from torch import Tensor

from schemas.description import Floats
from schemas.image import Bytes2D
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork


class TorchEngine:
    """Runs `CompactNetwork` itself, in float32.

    Parameters
    ----------
    content : bytes
        Content of ``compact.safetensors``.
    fine : sequence of bytes
        Contents of the weights of the members of `worker.encoders.compact.ensemble.ENSEMBLE` that are there.
    device : str
        ``cuda``, ``cpu``, ...
    """

    def __init__(self, content: bytes, fine: Sequence[bytes], device: str) -> None:
        state = {name: tensor for name, tensor in load(content).items() if not name.startswith("text.")}
        self._device = torch.device(device)
        self._network = CompactNetwork.loaded(state).to(self._device)
        self._members: list[Callable[[Tensor], Tensor]] = []
        if fine:
            first = SegmentationNetwork.loaded(load(fine[0])).to(self._device)
            self._members.append(lambda batch: first(*self._network.levels(batch)))
        self._members += [IndependentSegmentationNetwork.loaded(load(second)).to(self._device) for second in fine[1:]]

    @torch.inference_mode()
    def fields(self, images: Bytes2D) -> tuple[Floats, Floats]:
        """See `Engine.fields`."""
        words, detail = self._network(self._batch(images))
        return _cells(words), _cells(detail)

    @torch.inference_mode()
    def segment(self, images: Bytes2D, member: int) -> Floats:
        """See `Engine.segment`."""
        return _cells(self._members[member](self._batch(images)))

    def _batch(self, images: Bytes2D) -> Tensor:
        batch = torch.from_numpy(images).to(self._device).permute(0, 3, 1, 2)
        return (batch.float() / 255).contiguous(memory_format=torch.channels_last)


def _cells(layer: Tensor) -> Floats:
    cells: Floats = layer.permute(0, 2, 3, 1).contiguous().float().cpu().numpy()
    return cells
