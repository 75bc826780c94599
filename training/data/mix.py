"""The composition of a batch: how many views of what size, and how often each source is drawn for them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from training.data.viewpoint import ZOOM

PSEUDO_LABELLED = "trunk pseudo-labels"
"""Name of the data set whose label maps are those of the pretrained trunk."""

# How often each source is drawn, relative to the others that a data folder has: `drawn` and `free` are those of
# `training.commands.open_data`, and in no folder beside the other sets.
LABELLED_SHARES = {"camvid": 0.30, "labelmefacade": 0.26, "nyuv2": 0.32, "ade_outdoor": 0.12, "drawn": 0.3}
SEGMENTATION_SHARES = {"camvid": 0.40, "labelmefacade": 0.30, "nyuv2": 0.24, "ade_outdoor": 0.06}
STRONG_SHARES = {
    "camvid": 0.22,
    "labelmefacade": 0.22,
    "nyuv2": 0.20,
    "ade_outdoor": 0.08,
    "drawn": 0.15,
    "free": 0.30,
    PSEUDO_LABELLED: 0.16,
    "indoor": 0.25,
    "aligned": 0.37,
}
MILD_SHARES = {
    "camvid": 0.18,
    "labelmefacade": 0.22,
    "nyuv2": 0.20,
    "ade_outdoor": 0.08,
    "drawn": 0.10,
    "free": 0.45,
    PSEUDO_LABELLED: 0.04,
    "indoor": 0.28,
    "aligned": 0.12,
}


@dataclass(frozen=True)
class Mix:
    """The composition of a batch.

    Attributes
    ----------
    strong, mild : int
        Pairs of views with strong and with mild photometric augmentation.
    strong_shares, mild_shares : mapping of str to float
        How often each source is drawn for either, relative to the others.
    labelled : int
        Single labelled views, for the label loss alone: larger than those of pairs, with mild augmentation.
    labelled_strong : float
        Share of the labelled views that get strong augmentation instead, 0..1.
    labelled_pasted : float
        Share of the labelled views onto which foreground objects of another view of the same set are pasted, pixel by
        pixel with their labels, 0..1 (Ghiasi et al. 2021, "Simple Copy-Paste").
    labelled_shares : mapping of str to float
        How often each labelled set is drawn for them, relative to the others.
    size, labelled_size : (int, int)
        Height and width of a view in pixels, multiples of 32.
    labelled_zoom : (float, float)
        Least and greatest enlargement of a labelled view, for a source 360 pixels high. A view is always enlarged
        enough to lie within its source.
    labelled_stride : int
        Pixels of a labelled view per label, along either side.
    """

    strong: int = 4
    mild: int = 4
    labelled: int = 4
    labelled_strong: float = 0.0
    labelled_pasted: float = 0.0
    strong_shares: Mapping[str, float] = field(default_factory=lambda: STRONG_SHARES)
    mild_shares: Mapping[str, float] = field(default_factory=lambda: MILD_SHARES)
    labelled_shares: Mapping[str, float] = field(default_factory=lambda: LABELLED_SHARES)
    size: tuple[int, int] = (192, 256)
    labelled_size: tuple[int, int] = (288, 384)
    labelled_zoom: tuple[float, float] = ZOOM
    labelled_stride: int = 4
