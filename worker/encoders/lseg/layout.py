"""The tensors of LSeg's checkpoint: those the networks need, those it carries besides, and how a file departs."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from worker.encoders.lseg.config import Config
from worker.encoders.lseg.network import Network

Shape = tuple[int, ...]

SHOWN = 8
"""Names or differences that one sentence lists."""

FLOATS = frozenset({torch.float64, torch.float32, torch.float16, torch.bfloat16})


@dataclass(frozen=True)
class Layout:
    """Names (without the checkpoint's ``net.``) and shapes.

    Parameters
    ----------
    used : mapping of name to shape
        What the networks are made of. Every one must be there.
    unused : mapping of name to shape
        What the published checkpoint carries besides; may be left out.
    """

    used: Mapping[str, Shape]
    unused: Mapping[str, Shape]

    @classmethod
    def of(cls, config: Config) -> "Layout":
        """The layout of a network's checkpoint."""
        with torch.device("meta"):
            network = Network(config)
        used = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
        return cls(used, dict(_unused(config)))


def _unused(config: Config) -> Iterator[tuple[str, Shape]]:
    """What the checkpoint carries without LSeg's using it."""
    yield "clip_pretrained.logit_scale", ()
    for name, shape in _image_tower(config):
        yield f"clip_pretrained.visual.{name}", shape
    yield "pretrained.model.norm.weight", (config.width,)
    yield "pretrained.model.norm.bias", (config.width,)
    yield "pretrained.model.head.weight", (config.classes, config.width)
    yield "pretrained.model.head.bias", (config.classes,)
    square = (config.features, config.features, 3, 3)
    for step in (1, 2, 3, 4):
        for unit in (1, 2):
            prefix = f"scratch.refinenet{step}.resConfUnit{unit}"
            for index in (1, 2):
                yield f"{prefix}.bn{index}.num_batches_tracked", ()
                if (step, unit) == (4, 1):
                    yield f"{prefix}.conv{index}.weight", square
                    for name in ("weight", "bias", "running_mean", "running_var"):
                        yield f"{prefix}.bn{index}.{name}", (config.features,)


def _image_tower(config: Config) -> Iterator[tuple[str, Shape]]:
    """CLIP's image tower."""
    tower = config.image_tower
    width = tower.width
    yield "class_embedding", (width,)
    yield "positional_embedding", (tower.positions, width)
    yield "proj", (width, config.channels)
    yield "conv1.weight", (width, 3, tower.patch, tower.patch)
    for index in range(tower.depth):
        block = f"transformer.resblocks.{index}"
        yield f"{block}.attn.in_proj_weight", (3 * width, width)
        yield f"{block}.attn.in_proj_bias", (3 * width,)
        for layer, rows, columns in (
            ("attn.out_proj", width, width),
            ("mlp.c_fc", 4 * width, width),
            ("mlp.c_proj", width, 4 * width),
        ):
            yield f"{block}.{layer}.weight", (rows, columns)
            yield f"{block}.{layer}.bias", (rows,)
        for norm in ("ln_1", "ln_2"):
            yield from _norm(f"{block}.{norm}", width)
    yield from _norm("ln_pre", width)
    yield from _norm("ln_post", width)


def _norm(name: str, width: int) -> Iterable[tuple[str, Shape]]:
    """A LayerNorm's two tensors."""
    return ((f"{name}.weight", (width,)), (f"{name}.bias", (width,)))


def differences(tensors: Mapping[str, Tensor], layout: Layout) -> tuple[str, ...]:
    """How a file's tensors depart from the layout, one sentence each, by name.

    A surplus tensor is a fault like a missing one: LSeg's variants with further head blocks differ from the published
    network by nothing else, and leaving those blocks out would change every embedding without an error.
    """
    if not layout.used.keys() & tensors.keys():
        some = ", ".join(sorted(tensors)[:SHOWN]) or "none"
        return (f"none of LSeg's {len(layout.used)} tensors is there; the file's {len(tensors)} begin with: {some}",)
    known = {**layout.unused, **layout.used}
    missing = sorted(layout.used.keys() - tensors.keys())
    found = [f"{name}: missing, expected shape {list(layout.used[name])}" for name in missing]
    for name, tensor in sorted(tensors.items()):
        if name not in known:
            found.append(f"{name}: surplus, of shape {list(tensor.shape)}")
        elif tuple(tensor.shape) != known[name]:
            found.append(f"{name}: shape {list(tensor.shape)}, expected {list(known[name])}")
        elif name in layout.used and tensor.dtype not in FLOATS:
            found.append(f"{name}: {tensor.dtype}, expected a floating-point type")
        elif name in layout.used and not bool(tensor.float().sum(dtype=torch.float64).isfinite()):
            found.append(f"{name}: holds values that are not finite")
    return tuple(found)
