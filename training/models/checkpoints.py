"""Networks read from checkpoints of a run (``.pt``) and from exported files (``.safetensors``)."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor

from training.models.network import REFINEMENT_PREFIX
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

State = dict[str, Tensor]


def read_average(checkpoint: Path) -> State:
    """Read the averaged weights of a checkpoint."""
    average: State = torch.load(checkpoint, map_location="cpu", weights_only=True)["average"]
    return average


def reduced(state: Mapping[str, Tensor]) -> tuple[State, Tensor]:
    """Reduce the 512-d semantic head to the 97 dimensions it spans; lengths and cosines stay. Leave out `refine`.

    An embedding is e = W y + b with a 96-d y. With [W b] = U S V' (singular values) the vector z = S V' [y; 1] has
    e = U z and, U having orthonormal columns, the same lengths and cosines.

    Parameters
    ----------
    state : mapping of str to Tensor
        Of `TrainedNetwork`.

    Returns
    -------
    state : dict of str to Tensor
        Of ``CompactNetwork(97)``.
    basis : float32 of shape (512, 97)
        U.
    """
    weight, bias = state["words.weight"], state["words.bias"]
    whole = torch.cat([weight.flatten(1), bias[:, None]], dim=1).double()
    basis, lengths, directions = torch.linalg.svd(whole, full_matrices=False)
    short = (lengths[:, None] * directions).float()
    smaller = {name: tensor for name, tensor in state.items() if not name.startswith(REFINEMENT_PREFIX)}
    smaller["words.weight"] = short[:, :-1, None, None].contiguous()
    smaller["words.bias"] = short[:, -1].contiguous()
    return smaller, basis.float()


def load_network(path: Path) -> CompactNetwork:
    """Load a network for inference, in its 97 dimensions."""
    if path.suffix == ".pt":
        return CompactNetwork.loaded(reduced(read_average(path))[0])
    return CompactNetwork.loaded({name: t for name, t in load_file(path).items() if not name.startswith("text.")})


def load_basis(path: Path) -> Tensor:
    """Load the basis of a network's 97 dimensions: float32 of shape (512, 97)."""
    return reduced(read_average(path))[1] if path.suffix == ".pt" else load_file(path)["text.basis"].float()


def load_segmentation_network(path: Path) -> SegmentationNetwork:
    """Load a segmentation network that shares the shallow layers of `CompactNetwork`, for inference."""
    return SegmentationNetwork.loaded(_read(path))


def load_independent_network(path: Path) -> IndependentSegmentationNetwork:
    """Load a segmentation network that shares no layers, for inference."""
    return IndependentSegmentationNetwork.loaded(_read(path))


def shared_digest(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 (hex) of those exported tensors that segmentation networks depend on: shallow layers and basis."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        if name.startswith(("stride2.", "stride4.", "stride8.", "text.basis")):
            digest.update(name.encode())
            digest.update(tensors[name].contiguous().numpy().tobytes())
    return digest.hexdigest()


def _read(path: Path) -> State:
    return read_average(path) if path.suffix == ".pt" else load_file(path)
