"""How windows lie over a picture, worked by hand, and the whole routine against an independent one."""

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.encoders.lseg import naive, small
from worker.encoders.lseg.config import PUBLISHED
from worker.encoders.lseg.encoder import LsegEncoder
from worker.encoders.lseg.windows import Single, Windows, resized


@pytest.mark.parametrize(
    ("size", "grid", "windows"),
    [
        ((376, 1241), (158, 520), [((0, 158), (0, 480)), ((0, 158), (320, 520))]),
        ((240, 320), (390, 520), [((0, 390), (0, 480)), ((0, 390), (320, 520))]),
        # A short side above 480 takes a second row: 4 windows.
        (
            (300, 290),
            (520, 503),
            [
                ((0, 480), (0, 480)),
                ((0, 480), (320, 503)),
                ((320, 520), (0, 480)),
                ((320, 520), (320, 503)),
            ],
        ),
        ((480, 520), (480, 520), [((0, 480), (0, 480)), ((0, 480), (320, 520))]),
        ((100, 100), (520, 520), None),
        # Halves go up: 240 x 520/960 = 130, 241 x 520/960 = 130.54.
        ((241, 960), (131, 520), None),
        ((960, 237), (520, 128), None),
        # One row is left of a picture a thousand times as wide as high.
        ((32, 40000), (1, 520), [((0, 1), (0, 480)), ((0, 1), (320, 520))]),
    ],
)
def test_the_published_windows(
    size: tuple[int, int], grid: tuple[int, int], windows: list[tuple[tuple[int, int], tuple[int, int]]] | None
) -> None:
    covering = Windows(PUBLISHED)

    assert covering.grid(size) == grid
    if windows is not None:
        places = [((r.start, r.stop), (c.start, c.stop)) for r, c in covering.places(grid)]
        assert places == windows


def test_windows_are_padded_with_black_to_the_right_and_below() -> None:
    white = np.full((30, 104, 3), 255, np.uint8)

    first, second = Windows(small.SMALL).inputs(white)

    assert first.pixels.shape == second.pixels.shape == (3, 96, 96)
    assert (second.pixels[:, :30, :40] == 1).all()
    assert (second.pixels[:, 30:] == -1).all()
    assert (second.pixels[:, :, 40:] == -1).all()


def test_where_windows_overlap_the_mean_is_taken() -> None:
    """Outputs that are constant over a window stay so when enlarged: 1 and 3 make 2 in the overlap."""
    outputs = (torch.full((48, 48, 2), value, dtype=torch.float16) for value in (1.0, 3.0))

    field = Windows(small.SMALL).join((30, 104), outputs)

    assert field.shape == (30, 104, 2)
    assert (field[:, :64] == 1).all()
    assert (field[:, 64:96] == 2).all()
    assert (field[:, 96:] == 3).all()


def test_a_window_is_enlarged_with_aligned_corners() -> None:
    """From 48 to 96 cells, cell i lies at 47 i/95."""
    ramp = torch.arange(48.0).half()[None, :, None].expand(48, 48, 1)

    field = Windows(small.SMALL).join((30, 104), iter([ramp, ramp]))

    expected = torch.arange(64) * 47 / 95
    torch.testing.assert_close(field[7, :64, 0], expected, rtol=1e-6, atol=1e-5)


def test_resizing_is_pytorchs_on_normalised_pixels() -> None:
    pixels = np.random.default_rng(3).integers(0, 256, (37, 53, 3)).astype(np.uint8)
    normalised = (torch.from_numpy(pixels).float() / 255 - 0.5) / 0.5

    there = resized(pixels, (73, 104))

    expected = torch.nn.functional.interpolate(
        normalised.permute(2, 0, 1)[None], size=(73, 104), mode="bilinear", align_corners=True
    )[0]
    torch.testing.assert_close(there, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("size", "sides"),
    [((376, 1241), (160, 528)), ((240, 320), (384, 528)), ((300, 290), (528, 496)), ((9, 900), (16, 528))],
)
def test_a_single_pass_keeps_the_aspect_in_whole_patches(size: tuple[int, int], sides: tuple[int, int]) -> None:
    assert Single(PUBLISHED).input_size(size) == sides


@pytest.fixture(scope="module")
def weights() -> dict[str, Tensor]:
    return small.state()


def ours(weights: dict[str, Tensor], height: int, width: int) -> Tensor:
    encoder = LsegEncoder(small.network(weights), small.tokenizer(), "0" * 64)
    return next(encoder.raw([small.image(height, width)])).permute(2, 0, 1).double()


def reference(weights: dict[str, Tensor], height: int, width: int, slip: str = "") -> Tensor:
    exact = {name: tensor.double() for name, tensor in weights.items()}
    return naive.field(small.image(height, width).pixels, exact, small.SMALL, slip)


@pytest.mark.parametrize("size", [(40, 130), (60, 80), (75, 72)])
def test_the_whole_routine_agrees_with_an_independent_one(weights: dict[str, Tensor], size: tuple[int, int]) -> None:
    difference = (ours(weights, *size) - reference(weights, *size)).abs()

    # A pixel that float32 puts on the other side of a rounding to half precision is off by 2^-7.
    assert difference.max() < 0.02
    assert difference.mean() < 2e-5


@pytest.mark.parametrize("slip", naive.WINDOW_SLIPS)
def test_every_slip_would_be_seen(weights: dict[str, Tensor], slip: str) -> None:
    # Upright, with a second row of windows.
    difference = (ours(weights, 75, 72) - reference(weights, 75, 72, slip)).abs()

    assert difference.mean() > 1e-3
