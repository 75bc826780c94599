"""Where training starts: the pretrained trunk, or an earlier network whose fusion had batch norms."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.models.network import TrainedNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork

State = dict[str, Tensor]

KEPT_AT_STRIDE4 = (0, 2, 3)
"""Which of the trunk's four blocks at stride 4 are kept: the strided one and two of the residual ones.

Without block 1 the words field of a trained network changes least: mean cosine 0.989 with the whole.
"""

_RAISED = 20.0
"""What the trunk's scores are raised by: the least of them are about -15."""

_STAGES = {"s2": "stride2", "s4": "stride4", "s8": "stride8", "s16": "stride16", "deep": "deep", "last": "context.last"}
_HEADS = {"aspp": "context.local", "pool": "context.whole", "cat": "context.joined", "cls": "classes"}


def trunk_state(path: Path) -> State:
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


def earlier_state(path: Path) -> State:
    """Read a checkpoint of this training, or of an earlier network (trunk under ``t.``, fusion with batch norms).

    The batch norms are folded into the convolutions before them.
    """
    content = torch.load(path, map_location="cpu", weights_only=False)
    if "average" in content:
        averaged: State = content["average"]
        return averaged
    saved = content["net"]
    saved = {name: tensor.float() for name, tensor in saved.items() if tensor.is_floating_point()}
    state = renamed({name[2:]: tensor for name, tensor in saved.items() if name.startswith("t.")})
    for old, new in {"l16": "from16", "l8": "from8", "l4": "from4", "head": "words"}.items():
        state[f"{new}.weight"], state[f"{new}.bias"] = saved[f"{old}.weight"], saved[f"{old}.bias"]
    for convolution, norm, place in ((0, 1, 0), (3, 4, 2)):
        gain = saved[f"f.{norm}.weight"] / (saved[f"f.{norm}.running_var"] + 1e-5).sqrt()
        state[f"fuse.{place}.weight"] = saved[f"f.{convolution}.weight"] * gain[:, None, None, None]
        state[f"fuse.{place}.bias"] = saved[f"f.{norm}.bias"] - saved[f"f.{norm}.running_mean"] * gain
    return state


def started(pretrained: Path) -> tuple[TrainedNetwork, set[str]]:
    """Build the network to train, from the trunk (``.npz``) or from an earlier network (``.pt``).

    What the file does not hold keeps torch's own random start, so seed torch before.

    Returns
    -------
    network
    missing
        Names of the parameters that the file does not hold.
    """
    network = TrainedNetwork()
    state = renamed(trunk_state(pretrained)) if pretrained.suffix == ".npz" else earlier_state(pretrained)
    state = {name: tensor for name, tensor in state.items() if not name.startswith("classes.")}
    missing, unknown = network.load_state_dict(state, strict=False)
    if unknown:
        raise ValueError(f"{pretrained} holds tensors that the network has no place for: {unknown[:4]}")
    return network, set(missing)


def second_started(trunk: Mapping[str, Tensor], vectors: Tensor) -> IndependentSegmentationNetwork:
    """Build segmentation network that begin with the trunk's layers, and with a words head that ranks its 19 words as it does.

    Its layers up to stride 4 stay as they are: edges and colours are the same everywhere, and a step takes a third
    less. Its scores are the first 19 channels of what the words are read from, raised so that no ReLU cuts them; the
    others, and what sharpens them, begin as torch begins them and are not heard at first.

    Parameters
    ----------
    trunk
        As `trunk_state` reads it.
    vectors : float of shape (19, channels)
        Of its words, in the space of the words head.
    """
    second = IndependentSegmentationNetwork(vectors.shape[1])
    state = renamed(trunk)
    for part in (second.shallow, second.fine):
        names = part.state_dict().keys() & state.keys()
        part.load_state_dict({name: state[name] for name in names}, strict=False)
    for layers in (second.shallow.stride2, second.shallow.stride4):
        layers.requires_grad_(False)
    own = second.fine.state_dict()  # its tensors are the network's own
    spoken, classes = len(vectors), state["classes.weight"]
    for silent in ("from16", "from8", "from4", "fuse.2"):
        own[f"{silent}.weight"][:spoken] = 0
        own[f"{silent}.bias"][:spoken] = 0
    own["from16.weight"][:spoken, -classes.shape[1] :] = classes
    own["from16.bias"][:spoken] = state["classes.bias"] + _RAISED
    own["words.weight"].zero_()
    own["words.weight"][:, :spoken, 0, 0] = torch.linalg.pinv(vectors) @ (torch.eye(spoken) - 1 / spoken)
    own["words.bias"].zero_()
    return second
