"""Sizes of the network. The published one is `PUBLISHED`; tests shrink it without leaving any code path."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ImageTower:
    """CLIP's image tower: it lies in the checkpoint, takes no part in LSeg, and is checked but not loaded."""

    width: int = 768
    depth: int = 12
    patch: int = 32
    positions: int = 50


@dataclass(frozen=True)
class Config:
    """Sizes of LSeg's networks and of the routine that covers an image with them.

    Parameters
    ----------
    patch, width, heads, depth, hidden : int
        Vision transformer: side of a patch in pixels, channels, attention heads, blocks, channels within a block.
    table : int
        Side of the position table, in patches.
    classes : int
        Outputs of the transformer's classifier, which is in the checkpoint but not used.
    taps : four ints
        Blocks (from 0) whose outputs the decoder reads.
    tap_channels : four ints
        Channels of each tap after reassembly.
    features : int
        Channels of the decoder.
    channels : int
        Channels of a pixel's embedding and of a text vector: CLIP's joint space.
    text_width, text_heads, text_depth : int
        Text tower.
    context : int
        Longest token sequence, start and end tokens included.
    tokens : int
        Size of the token table.
    base, crop, stride : int
        The image's longer side, the side of a window, and the step between windows, in pixels.
    image_tower : ImageTower
    """

    patch: int = 16
    width: int = 1024
    heads: int = 16
    depth: int = 24
    hidden: int = 4096
    table: int = 24
    classes: int = 1000
    taps: tuple[int, int, int, int] = (5, 11, 17, 23)
    tap_channels: tuple[int, int, int, int] = (256, 512, 1024, 1024)
    features: int = 256
    channels: int = 512
    text_width: int = 512
    text_heads: int = 8
    text_depth: int = 12
    context: int = 77
    tokens: int = 49408
    base: int = 520
    crop: int = 480
    stride: int = 320
    image_tower: ImageTower = ImageTower()


PUBLISHED = Config()
"""``demo_e200.ckpt``: ViT-L/16 at 384 pixels, DPT decoder, CLIP ViT-B/32."""
