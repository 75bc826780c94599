"""How a batch is put together: how many views of what size, and how often each source is drawn for them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from training.data import viewpoint

STREET = "street words of the trunk"
"""Labelled set whose labels the untouched trunk gave."""

# How often each source is drawn, relative to the others.
CLEAR_SHARES = {"camvid": 0.30, "labelmefacade": 0.26, "nyuv2": 0.32, "ade_outdoor": 0.12}
SEGMENTATION_SHARES = {"camvid": 0.40, "labelmefacade": 0.30, "nyuv2": 0.24, "ade_outdoor": 0.06}
STRONG_SHARES = {
    "camvid": 0.22,
    "labelmefacade": 0.22,
    "nyuv2": 0.20,
    "ade_outdoor": 0.08,
    STREET: 0.16,
    "indoor": 0.25,
    "aligned": 0.37,
}
MILD_SHARES = {
    "camvid": 0.18,
    "labelmefacade": 0.22,
    "nyuv2": 0.20,
    "ade_outdoor": 0.08,
    STREET: 0.04,
    "indoor": 0.28,
    "aligned": 0.12,
}


@dataclass(frozen=True)
class Mix:
    """How a batch is put together.

    Attributes
    ----------
    strong, mild
        Pairs of views under strongly and under mildly changed light.
    strong_shares, mild_shares
        How often each source is drawn for either, relative to the others.
    clear
        Single labelled views, larger than the others and in mildly changed light, for their labels alone.
    clear_strong
        Share of these whose light is changed strongly instead.
    clear_pasted
        Share of these that things in front are pasted onto, pixel by pixel with their labels, from another view of the
        same set (Ghiasi et al. 2021, "Simple Copy-Paste").
    clear_shares
        How often each labelled set is drawn for them, relative to the others.
    size, clear_size
        Height and width of a view in pixels, multiples of 32.
    clear_zoom
        Least and greatest enlargement of these, for a source 360 pixels high; what fills the view is the least anyway.
    clear_stride
        Pixels of a single view for each label along either side.
    """

    strong: int = 4
    mild: int = 4
    clear: int = 4
    clear_strong: float = 0.0
    clear_pasted: float = 0.0
    strong_shares: Mapping[str, float] = field(default_factory=lambda: STRONG_SHARES)
    mild_shares: Mapping[str, float] = field(default_factory=lambda: MILD_SHARES)
    clear_shares: Mapping[str, float] = field(default_factory=lambda: CLEAR_SHARES)
    size: tuple[int, int] = (192, 256)
    clear_size: tuple[int, int] = (288, 384)
    clear_zoom: tuple[float, float] = viewpoint.ZOOM
    clear_stride: int = 4
