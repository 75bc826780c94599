"""Networks before their first step: from the pretrained trunk, or from networks trained earlier."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.models.checkpoints import State, read_average
from training.models.network import TrainedNetwork
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

KEPT_AT_STRIDE4 = (0, 2, 3)
"""Which of the trunk's four blocks at stride 4 are kept: the strided one and two of the residual ones.

Leaving out block 1 changes the semantic field of a trained network least: mean cosine 0.989 with the whole.
"""

_RAISED = 20.0
"""Added to the trunk's logits, the least of which are about -15, so that no ReLU cuts them."""

_STAGES = {"s2": "stride2", "s4": "stride4", "s8": "stride8", "s16": "stride16", "deep": "deep", "last": "context.last"}
_HEADS = {"aspp": "context.local", "pool": "context.whole", "cat": "context.joined", "cls": "classes"}


def read_trunk(path: Path) -> State:
    """Read the trunk's tensors from ``cityscapes_trunk_fp16.npz``, as float32 under the names of the file."""
    with np.load(path) as arrays:
        return {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in arrays.files}


def renamed(trunk: Mapping[str, Tensor], kept_at_stride4: tuple[int, ...] = KEPT_AT_STRIDE4) -> State:
    """Give the trunk's tensors the names of the network, leaving out blocks that are not kept at stride 4."""
    state: State = {}
    for name, tensor in trunk.items():
        stage, rest = name.split(".", 1)
        if stage == "s4":
            block, rest = rest.split(".", 1)
            if int(block) not in kept_at_stride4:
                continue
            rest = f"{kept_at_stride4.index(int(block))}.{rest}"
        if stage in _STAGES:
            rest = re.sub(r"\bm\.", "convolutions.", rest)
            state[f"{_STAGES[stage]}.{rest}"] = tensor
        elif stage in _HEADS:
            state[f"{_HEADS[stage]}.{rest}"] = tensor
    return {re.sub(r"\bc\.(weight|bias)$", r"convolution.\1", name): tensor for name, tensor in state.items()}


def initial_network(pretrained: Path) -> tuple[TrainedNetwork, set[str]]:
    """Build the network to train.

    Parameters
    ----------
    pretrained : Path
        The trunk (``.npz``), or a checkpoint (``.pt``) of this training or of a network with batch norms (see
        `_with_batch_norms`). Parameters that the file does not hold keep torch's random start, so seed torch before.

    Returns
    -------
    network : TrainedNetwork
    missing : set of str
        Names of the parameters that the file does not hold.

    Raises
    ------
    ValueError
        The file holds tensors of another network.
    """
    network = TrainedNetwork()
    state = renamed(read_trunk(pretrained)) if pretrained.suffix == ".npz" else _read_checkpoint(pretrained)
    state = {name: tensor for name, tensor in state.items() if not name.startswith("classes.")}
    missing, unknown = network.load_state_dict(state, strict=False)
    if unknown:
        raise ValueError(f"{pretrained} holds tensors that the network has no place for: {unknown[:4]}")
    return network, set(missing)


def initial_segmentation_network(network: CompactNetwork) -> SegmentationNetwork:
    """Copy a network's deep layers and semantic head; the sharpening adds nothing yet.

    Raises
    ------
    ValueError
        The network lacks some layer.
    """
    copy = SegmentationNetwork(network.words.out_channels)
    missing, _ = copy.load_state_dict(network.state_dict(), strict=False)
    lacking = [name for name in missing if not name.startswith("sharpen.")]
    if lacking:
        raise ValueError(f"the network to start from lacks {', '.join(lacking[:4])}")
    return copy


def initial_independent_network(trunk: Mapping[str, Tensor], vectors: Tensor) -> IndependentSegmentationNetwork:
    """Build an independent segmentation network that at first ranks the trunk's 19 labels as the trunk does.

    Its layers up to stride 4 are frozen: edges and colours are the same everywhere, and a step takes a third less. The
    first 19 inputs of its semantic head are the trunk's logits, raised so that no ReLU cuts them. The other inputs,
    and the sharpening, keep torch's random start and have no influence at first.

    Parameters
    ----------
    trunk : mapping of str to Tensor
        As `read_trunk` gives it.
    vectors : float of shape (19, channels)
        Of the trunk's labels, in the space of the embeddings.
    """
    network = IndependentSegmentationNetwork(vectors.shape[1])
    state = renamed(trunk)
    for part in (network.shallow, network.fine):
        names = part.state_dict().keys() & state.keys()
        part.load_state_dict({name: state[name] for name in names}, strict=False)
    for layers in (network.shallow.stride2, network.shallow.stride4):
        layers.requires_grad_(False)
    own = network.fine.state_dict()  # its tensors are the network's own
    count, classes = len(vectors), state["classes.weight"]
    for silent in ("from16", "from8", "from4", "fuse.2"):
        own[f"{silent}.weight"][:count] = 0
        own[f"{silent}.bias"][:count] = 0
    own["from16.weight"][:count, -classes.shape[1] :] = classes
    own["from16.bias"][:count] = state["classes.bias"] + _RAISED
    own["words.weight"].zero_()
    own["words.weight"][:, :count, 0, 0] = torch.linalg.pinv(vectors) @ (torch.eye(count) - 1 / count)
    own["words.bias"].zero_()
    return network


def _read_checkpoint(path: Path) -> State:
    content = torch.load(path, map_location="cpu", weights_only=False)
    return read_average(path) if "average" in content else _with_batch_norms(content["net"])


def _with_batch_norms(saved: Mapping[str, Tensor]) -> State:
    """Take up a network from before this training: trunk under ``t.``, batch norms in the fusion.

    The batch norms are folded into the convolutions before them.
    """
    saved = {name: tensor.float() for name, tensor in saved.items() if tensor.is_floating_point()}
    state = renamed({name[2:]: tensor for name, tensor in saved.items() if name.startswith("t.")})
    for old, new in {"l16": "from16", "l8": "from8", "l4": "from4", "head": "words"}.items():
        state[f"{new}.weight"], state[f"{new}.bias"] = saved[f"{old}.weight"], saved[f"{old}.bias"]
    for convolution, norm, place in ((0, 1, 0), (3, 4, 2)):
        gain = saved[f"f.{norm}.weight"] / (saved[f"f.{norm}.running_var"] + 1e-5).sqrt()
        state[f"fuse.{place}.weight"] = saved[f"f.{convolution}.weight"] * gain[:, None, None, None]
        state[f"fuse.{place}.bias"] = saved[f"f.{norm}.bias"] - saved[f"f.{norm}.running_mean"] * gain
    return state
