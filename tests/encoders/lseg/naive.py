"""LSeg once more, written from the papers with other means and no regard for speed: what the real one is held against.

Double precision; attention as a softmax of explicit scores, transposed convolutions as sums, enlargements as dense
matrices, windows on a canvas. `slip` names one mistake to make: a test that cannot tell it from the truth is no test.
"""

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from worker.encoders.lseg.config import Config

State = Mapping[str, Tensor]

NETWORK_SLIPS = (
    "tanh gelu",
    "layer norm eps 1e-5",
    "batch norm eps 1e-3",
    "bicubic position table",
    "position table with aligned corners",
    "class token first in the readout",
    "no class token in the readout",
    "final norm on the taps",
    "post-norm",
    "taps one block early",
    "decoder without aligned corners",
    "no relu before the first convolution",
    "unit 1 used without a tap",
    "no half precision",
    "scale not rounded to half",
)
WINDOW_SLIPS = ("bgr", "padding with 0", "resize without aligned corners", "windows not averaged", "last window flush")
TEXT_SLIPS = ("erf gelu", "no causal mask", "first padding token read", "projection transposed")


def matrix(source: int, target: int, *, aligned: bool) -> Tensor:
    """Bilinear interpolation as a matrix of shape (target, source)."""
    m = np.zeros((target, source))
    for i in range(target):
        if aligned:
            at = i * (source - 1) / (target - 1) if target > 1 else 0.0
        else:
            at = max((i + 0.5) * source / target - 0.5, 0.0)
        low = min(int(at), source - 1)
        high = min(low + 1, source - 1)
        m[i, low] += 1 - (at - low)
        m[i, high] += at - low
    return torch.from_numpy(m)


def scaled(x: Tensor, rows: int, columns: int, *, aligned: bool) -> Tensor:
    """Enlarge (channels, rows, columns)."""
    down, across = matrix(x.shape[1], rows, aligned=aligned), matrix(x.shape[2], columns, aligned=aligned)
    return torch.einsum("ih,chw,jw->cij", down, x, across)


def layer_norm(x: Tensor, state: State, name: str, eps: float) -> Tensor:
    mean = x.mean(-1, keepdim=True)
    variance = ((x - mean) ** 2).mean(-1, keepdim=True)
    return (x - mean) / torch.sqrt(variance + eps) * state[f"{name}.weight"] + state[f"{name}.bias"]


def dense(x: Tensor, state: State, name: str) -> Tensor:
    return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]


def gelu(x: Tensor, slip: str) -> Tensor:
    if slip == "tanh gelu":
        return 0.5 * x * (1 + torch.tanh(math.sqrt(2 / math.pi) * (x + 0.044715 * x**3)))
    return 0.5 * x * (1 + torch.erf(x / math.sqrt(2)))


def attention(qkv: Tensor, heads: int, *, causal: bool) -> Tensor:
    """(tokens, 3 width) to (tokens, width)."""
    tokens, width = qkv.shape[0], qkv.shape[1] // 3
    q, k, v = qkv[:, :width], qkv[:, width : 2 * width], qkv[:, 2 * width :]
    out = []
    for cut in torch.arange(width).chunk(heads):
        scores = q[:, cut] @ k[:, cut].T / math.sqrt(width // heads)
        if causal:
            scores = scores + torch.full((tokens, tokens), -math.inf, dtype=scores.dtype).triu(1)
        out.append(torch.softmax(scores, dim=1) @ v[:, cut])
    return torch.cat(out, dim=1)


def transformer(image: Tensor, state: State, config: Config, slip: str) -> tuple[list[Tensor], int, int]:
    """(3, height, width) to taps of (1 + patches, width)."""
    p, model = config.patch, "pretrained.model"
    rows, columns = image.shape[1] // p, image.shape[2] // p
    kernel = state[f"{model}.patch_embed.proj.weight"].flatten(1)
    patches = [
        image[:, r * p : (r + 1) * p, c * p : (c + 1) * p].flatten() for r in range(rows) for c in range(columns)
    ]
    x = torch.stack(patches) @ kernel.T + state[f"{model}.patch_embed.proj.bias"]
    x = torch.cat([state[f"{model}.cls_token"][0], x])
    table = state[f"{model}.pos_embed"][0]
    grid = table[1:].T.reshape(-1, config.table, config.table)
    if slip == "bicubic position table":
        grid = F.interpolate(grid[None], size=(rows, columns), mode="bicubic", align_corners=False)[0]
    else:
        grid = scaled(grid, rows, columns, aligned=slip == "position table with aligned corners")
    x = x + torch.cat([table[:1], grid.flatten(1).T])
    eps = 1e-5 if slip == "layer norm eps 1e-5" else 1e-6
    outputs = []
    for index in range(config.depth):
        block = f"{model}.blocks.{index}"
        if slip == "post-norm":
            x = layer_norm(x + _attended(x, state, block, config), state, f"{block}.norm1", eps)
            x = layer_norm(x + _mlp(x, state, block, slip), state, f"{block}.norm2", eps)
        else:
            x = x + _attended(layer_norm(x, state, f"{block}.norm1", eps), state, block, config)
            x = x + _mlp(layer_norm(x, state, f"{block}.norm2", eps), state, block, slip)
        outputs.append(x)
    taps = [outputs[max(tap - (slip == "taps one block early"), 0)] for tap in config.taps]
    if slip == "final norm on the taps":
        taps = [layer_norm(tap, state, f"{model}.norm", eps) for tap in taps]
    return taps, rows, columns


def _attended(x: Tensor, state: State, block: str, config: Config) -> Tensor:
    mixed = attention(dense(x, state, f"{block}.attn.qkv"), config.heads, causal=False)
    return dense(mixed, state, f"{block}.attn.proj")


def _mlp(x: Tensor, state: State, block: str, slip: str) -> Tensor:
    return dense(gelu(dense(x, state, f"{block}.mlp.fc1"), slip), state, f"{block}.mlp.fc2")


def convolved(x: Tensor, state: State, name: str, *, stride: int = 1) -> Tensor:
    """Convolution of (channels, rows, columns) with padding that keeps the size at stride 1."""
    kernel = state[f"{name}.weight"]
    bias = state.get(f"{name}.bias")
    return F.conv2d(x[None], kernel, bias, stride=stride, padding=kernel.shape[-1] // 2)[0]


def spread(x: Tensor, state: State, name: str) -> Tensor:
    """Transposed convolution whose stride is its kernel: every cell becomes a square of its own."""
    kernel = state[f"{name}.weight"]
    side = kernel.shape[-1]
    out = torch.einsum("ihw,iokl->ohkwl", x, kernel)
    return out.reshape(kernel.shape[1], x.shape[1] * side, x.shape[2] * side) + state[f"{name}.bias"][:, None, None]


def reassembled(tap: Tensor, index: int, rows: int, columns: int, state: State, slip: str) -> Tensor:
    name = f"pretrained.act_postprocess{index}"
    patch, first = tap[1:], tap[:1].expand(len(tap) - 1, -1)
    if slip == "no class token in the readout":
        first = torch.zeros_like(first)
    joined = [first, patch] if slip == "class token first in the readout" else [patch, first]
    x = gelu(dense(torch.cat(joined, dim=1), state, f"{name}.0.project.0"), slip)
    x = convolved(x.T.reshape(-1, rows, columns), state, f"{name}.3")
    if index in (1, 2):
        return spread(x, state, f"{name}.4")
    return convolved(x, state, f"{name}.4", stride=2) if index == 4 else x


def normalised(x: Tensor, state: State, name: str, slip: str) -> Tensor:
    eps = 1e-3 if slip == "batch norm eps 1e-3" else 1e-5
    mean, variance, weight, bias = (
        state[f"{name}.{part}"][:, None, None] for part in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / torch.sqrt(variance + eps) * weight + bias


def unit(x: Tensor, state: State, name: str, slip: str) -> Tensor:
    y = x if slip == "no relu before the first convolution" else x.clamp(min=0)
    y = normalised(convolved(y, state, f"{name}.conv1"), state, f"{name}.bn1", slip)
    return x + normalised(convolved(y.clamp(min=0), state, f"{name}.conv2"), state, f"{name}.bn2", slip)


def network(image: Tensor, state: State, config: Config, slip: str = "") -> Tensor:
    """(3, height, width) to embeddings at the head's resolution, (channels, height/2, width/2)."""
    taps, rows, columns = transformer(image, state, config, slip)
    maps = [reassembled(tap, i, rows, columns, state, slip) for i, tap in enumerate(taps, start=1)]
    path = torch.zeros(())
    for index in (4, 3, 2, 1):
        name = f"scratch.refinenet{index}"
        tap = convolved(maps[index - 1], state, f"scratch.layer{index}_rn")
        if index < 4 or slip == "unit 1 used without a tap":
            tap = unit(tap, state, f"{name}.resConfUnit1", slip)
        path = path + tap
        path = unit(path, state, f"{name}.resConfUnit2", slip)
        aligned = slip != "decoder without aligned corners"
        path = scaled(path, 2 * path.shape[1], 2 * path.shape[2], aligned=aligned)
        path = convolved(path, state, f"{name}.out_conv")
    x = convolved(path, state, "scratch.head1")
    x = x / torch.sqrt((x**2).sum(0, keepdim=True))
    if slip == "no half precision":
        return x * 14.2890625
    if slip == "scale not rounded to half":
        return (x.half().double() / 0.07).half().double()
    return (x.half().double() * 14.2890625).half().double()


def field(pixels: npt.NDArray[np.uint8], state: State, config: Config, slip: str = "") -> Tensor:
    """The window routine: (height, width, 3) to (channels, rows, columns)."""
    image = torch.from_numpy(pixels[:, :, ::-1].copy() if slip == "bgr" else pixels).double().permute(2, 0, 1)
    image = (image / 255 - 0.5) / 0.5
    height, width = pixels.shape[:2]
    longer = max(height, width)
    rows, columns = (int(side * config.base / longer + 0.5) for side in (height, width))
    image = scaled(image, rows, columns, aligned=slip != "resize without aligned corners")
    crop, stride = config.crop, config.stride
    high, wide = max(rows, crop), max(columns, crop)
    starts = [
        [min(stride * n, length - crop) if slip == "last window flush" else stride * n for n in range(count)]
        for length, count in ((s, math.ceil((s - crop) / stride) + 1) for s in (high, wide))
    ]
    black = 0.0 if slip == "padding with 0" else -1.0
    far = (starts[0][-1] + crop, starts[1][-1] + crop)
    canvas = torch.full((3, *far), black, dtype=torch.float64)
    canvas[:, :rows, :columns] = image
    total = torch.zeros(config.channels, *far, dtype=torch.float64)
    times = torch.zeros(far)
    for top in starts[0]:
        for left in starts[1]:
            here = (slice(None), slice(top, top + crop), slice(left, left + crop))
            total[here] += scaled(network(canvas[here], state, config), crop, crop, aligned=True)
            times[here[1:]] += 1
    return (total if slip == "windows not averaged" else total / times)[:, :rows, :columns]


def text_vector(ids: list[int], state: State, config: Config, slip: str = "") -> Tensor:
    """Token ids to a vector: padded to the whole context, as CLIP does."""
    padded = ids + [0] * (config.context - len(ids))
    tower = "clip_pretrained"
    x = state[f"{tower}.token_embedding.weight"][padded] + state[f"{tower}.positional_embedding"]
    for index in range(config.text_depth):
        block = f"{tower}.transformer.resblocks.{index}"
        y = layer_norm(x, state, f"{block}.ln_1", 1e-5)
        qkv = y @ state[f"{block}.attn.in_proj_weight"].T + state[f"{block}.attn.in_proj_bias"]
        mixed = attention(qkv, config.text_heads, causal=slip != "no causal mask")
        x = x + dense(mixed, state, f"{block}.attn.out_proj")
        y = dense(layer_norm(x, state, f"{block}.ln_2", 1e-5), state, f"{block}.mlp.c_fc")
        y = gelu(y, slip) if slip == "erf gelu" else y / (1 + torch.exp(-1.702 * y))
        x = x + dense(y, state, f"{block}.mlp.c_proj")
    row = len(ids) - (slip != "first padding token read")
    projection = state[f"{tower}.text_projection"]
    vector = layer_norm(x, state, f"{tower}.ln_final", 1e-5)[row] @ (
        projection.T if slip == "projection transposed" else projection
    )
    return vector / torch.sqrt((vector**2).sum())
