"""A shrunken LSeg: the same code paths in thousandths of the time."""

import functools
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from schemas.image import Image
from worker.encoders.lseg.config import Config, ImageTower
from worker.encoders.lseg.layout import Layout
from worker.encoders.lseg.network import Network
from worker.encoders.lseg.tokenizer import Tokenizer

MERGES = [("a", "r</w>"), ("c", "ar</w>"), ("s", "k"), ("sk", "y</w>"), ("r", "o"), ("ro", "a"), ("roa", "d</w>")]

SMALL = Config(
    width=32,
    heads=2,
    depth=8,
    hidden=64,
    table=4,
    classes=5,
    taps=(1, 3, 5, 7),
    tap_channels=(8, 12, 16, 16),
    features=8,
    channels=16,
    text_width=16,
    text_heads=2,
    text_depth=2,
    context=12,
    tokens=512 + len(MERGES) + 2,
    base=104,
    crop=96,
    stride=64,
    image_tower=ImageTower(width=8, depth=1, patch=4, positions=5),
)
"""Windows overlap and stick out as the published ones do: 104 : 96 : 64 as 520 : 480 : 320."""

TOKENIZER_FILE_MERGES = "\n".join(" ".join(pair) for pair in MERGES)


def state() -> dict[str, Tensor]:
    """Random weights by name, without ``net.``, unused ones included; as much of each constant's effect as can be."""
    return {name: tensor.clone() for name, tensor in _state().items()}


@functools.cache
def _state() -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(1)
    layout = Layout.of(SMALL)
    tensors = {}
    for name, shape in {**layout.unused, **layout.used}.items():
        if name.endswith("num_batches_tracked"):
            tensors[name] = torch.tensor(1000)
            continue
        value = torch.rand(shape, generator=generator) * 2 - 1
        if name.endswith("running_var"):
            value = 0.02 + 0.01 * value  # small, so that an epsilon shows
        elif name.endswith(("norm1.weight", "norm2.weight", "norm.weight", "ln_1.weight", "ln_2.weight")):
            value = 1 + 0.3 * value
        elif "cls_token" in name or "pos_embed" in name or "patch_embed" in name:
            value = 0.003 * value  # a variance near 1e-6, the layer norm's epsilon
        elif "blocks.0.attn.proj" in name or "blocks.0.mlp.fc2" in name:
            value = 0.003 * value
        elif "token_embedding" in name or "fc1.weight" in name or "c_fc.weight" in name:
            value = 1.5 * value
        elif len(shape) > 1:
            value = 1.7 * value / (np.prod(shape[1:]) ** 0.5)
        tensors[name] = value
    return tensors


def network(tensors: dict[str, Tensor]) -> Network:
    """The real network with these weights."""
    with torch.device("meta"):
        made = Network(SMALL)
    made.load_state_dict({name: tensors[name].clone() for name in made.state_dict()}, assign=True)
    return made.eval().requires_grad_(False)


def tokenizer() -> Tokenizer:
    """A tokenizer that knows car, sky and road."""
    return Tokenizer(MERGES, SMALL.context)


def image(height: int, width: int, seed: int = 0) -> Image:
    """Noise over a gradient."""
    rng = np.random.default_rng(seed)
    slope = np.linspace(0, 150, width)[None, :, None] + np.array([0, 20, 60])
    return Image.of((slope + rng.integers(0, 40, (height, width, 3))).astype(np.uint8))


def save(tensors: dict[str, Tensor], path: Path, **further: object) -> Path:
    """A checkpoint as Lightning writes it."""
    named = {f"net.{name}": tensor for name, tensor in tensors.items()}
    torch.save({"epoch": 0, "pytorch-lightning_version": "1.4.9", "state_dict": named, **further}, path)
    return path
