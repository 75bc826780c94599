"""The compact network in torch: how it runs on a GPU, and what ONNX Runtime is compared with."""

import torch
from safetensors.torch import load
from torch import Tensor

from schemas.description import Floats
from schemas.errors import SetupError
from schemas.picture import Bytes2D
from worker.encoders.compact_fine import FineWords
from worker.encoders.compact_network import CompactNetwork


class TorchEngine:
    """Runs `CompactNetwork` itself, in float32.

    Parameters
    ----------
    content : bytes
        Of ``compact.safetensors``.
    fine : bytes or None
        Of ``compact-fine.safetensors``; None where there is none.
    device : str
        ``cuda``, ``cpu``, ...
    """

    def __init__(self, content: bytes, fine: bytes | None, device: str) -> None:
        state = {name: tensor for name, tensor in load(content).items() if not name.startswith("text.")}
        self._device = torch.device(device)
        self._network = CompactNetwork.loaded(state).to(self._device)
        self._fine = None if fine is None else FineWords.loaded(load(fine)).to(self._device)

    @torch.inference_mode()
    def fields(self, pictures: Bytes2D) -> tuple[Floats, Floats]:
        """See `Engine.fields`."""
        words, detail = self._network(self._batch(pictures))
        return _cells(words), _cells(detail)

    @torch.inference_mode()
    def fine_words(self, pictures: Bytes2D) -> Floats:
        """See `Engine.fine_words`."""
        if self._fine is None:
            raise SetupError("the encoder's weights came without fine words")
        return _cells(self._fine(*self._network.levels(self._batch(pictures))))

    def _batch(self, pictures: Bytes2D) -> Tensor:
        batch = torch.from_numpy(pictures).to(self._device).permute(0, 3, 1, 2)
        return (batch.float() / 255).contiguous(memory_format=torch.channels_last)


def _cells(layer: Tensor) -> Floats:
    cells: Floats = layer.permute(0, 2, 3, 1).contiguous().float().cpu().numpy()
    return cells
