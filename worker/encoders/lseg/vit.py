"""The vision transformer (Dosovitskiy et al., ICLR 2021) that LSeg reads images with: ViT-L/16 as timm 0.4.12 has it.

Attribute names are those of the checkpoint, so that its tensors load without a table of names. Constants that
weights cannot show were read in timm: LayerNorm eps 1e-6, exact (erf) GELU, normalisation before each half of a block.
"""

import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor, nn

from worker.encoders.lseg.config import Config
from worker.encoders.lseg.linear import linear

LAYER_NORM_EPS = 1e-6
"""timm's for vision transformers; PyTorch's default is 1e-5."""


class Attention(nn.Module):
    """Multi-head self-attention, queries, keys and values from one matrix."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Tokens (images, tokens, width) to the same shape."""
        n, t, width = x.shape
        qkv = linear(x, self.qkv.weight, self.qkv.bias).view(n, t, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(q, k, v)
        return linear(mixed.transpose(1, 2).reshape(n, t, width), self.proj.weight, self.proj.bias)


class Mlp(nn.Module):
    """Two dense layers with a GELU between them."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, hidden)
        self.fc2 = nn.Linear(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        """Tokens (images, tokens, width) to the same shape."""
        return linear(linear(x, self.fc1.weight, self.fc1.bias, gelu=True), self.fc2.weight, self.fc2.bias)


class Block(nn.Module):
    """A pre-norm transformer block."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(config.width, eps=LAYER_NORM_EPS)
        self.attn = Attention(config.width, config.heads)
        self.norm2 = nn.LayerNorm(config.width, eps=LAYER_NORM_EPS)
        self.mlp = Mlp(config.width, config.hidden)

    def forward(self, x: Tensor) -> Tensor:
        """Tokens (images, tokens, width) to the same shape."""
        x = x + self.attn(self.norm1(x))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y


class PatchEmbedding(nn.Module):
    """Each patch of pixels to one token."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, config.width, config.patch, stride=config.patch)

    def forward(self, images: Tensor) -> Tensor:
        """(images, 3, height, width) to (images, height/patch, width/patch, channels)."""
        patches: Tensor = self.proj(images)
        return patches.permute(0, 2, 3, 1)


class VisionTransformer(nn.Module):
    """Images to the outputs of four blocks."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.table = config.table
        self.taps = config.taps
        self.cls_token = nn.Parameter(torch.empty(1, 1, config.width))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + config.table**2, config.width))
        self.patch_embed = PatchEmbedding(config)
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.depth))

    def positions(self, rows: int, columns: int) -> Tensor:
        """The position table for a grid of another size.

        Parameters
        ----------
        rows, columns : int
            Patches of the image.

        Returns
        -------
        (1, 1 + rows * columns, width)
            First the class token's row, which is kept as it is; then the patches, row by row.

        Notes
        -----
        Bilinear with align_corners False and no anti-aliasing, as LSeg does; DPT's sources, from which LSeg's come,
        and timm itself (bicubic) differ here.
        """
        first, grid = self.pos_embed[:, :1], self.pos_embed[:, 1:]
        grid = grid.view(1, self.table, self.table, -1).permute(0, 3, 1, 2)
        grid = F.interpolate(grid, size=(rows, columns), mode="bilinear", align_corners=False)
        return torch.cat([first, grid.flatten(2).transpose(1, 2)], dim=1)

    def forward(self, images: Tensor) -> tuple[list[Tensor], tuple[int, int]]:
        """Outputs of the tapped blocks.

        Parameters
        ----------
        images : (images, 3, height, width)
            RGB in [-1, 1]; height and width multiples of the patch.

        Returns
        -------
        list of (images, 1 + rows * columns, width)
            One per tap, not normalised (the checkpoint's last LayerNorm is not used); the class token first.
        (int, int)
            (rows, columns) of patches.
        """
        patches = self.patch_embed(images)
        n, rows, columns, width = patches.shape
        x = torch.cat([self.cls_token.expand(n, -1, -1), patches.reshape(n, rows * columns, width)], dim=1)
        x = x + self.positions(rows, columns)
        tapped = []
        for index, block in enumerate(self.blocks[: max(self.taps) + 1]):
            x = block(x)
            if index in self.taps:
                tapped.append(x)
        return tapped, (rows, columns)
