"""The image network against an independent one, and against each mistake that is easily made."""

import pytest
import torch
from torch import Tensor

from tests.encoders.lseg import naive, small
from worker.encoders.lseg.enlarge import Axis, enlarge
from worker.encoders.lseg.linear import linear
from worker.encoders.lseg.network import Network

SIZE = (96, 64)
"""Not square, and a grid of 6 x 4 patches that is neither side of the position table."""


@pytest.fixture(scope="module")
def weights() -> dict[str, Tensor]:
    return small.state()


@pytest.fixture(scope="module")
def network(weights: dict[str, Tensor]) -> Network:
    return small.network(weights)


@pytest.fixture(scope="module")
def pixels() -> Tensor:
    return torch.rand((1, 3, *SIZE), generator=torch.Generator().manual_seed(5)) * 2 - 1


@pytest.fixture(scope="module")
def ours(network: Network, pixels: Tensor) -> Tensor:
    embeddings: Tensor = network(pixels)[0]
    return embeddings.permute(2, 0, 1).double()


def reference(pixels: Tensor, weights: dict[str, Tensor], slip: str = "") -> Tensor:
    exact = {name: tensor.double() for name, tensor in weights.items()}
    return naive.network(pixels[0].double(), exact, small.SMALL, slip)


def off(a: Tensor, b: Tensor) -> tuple[float, float]:
    """Largest and mean difference."""
    return (a - b).abs().max().item(), (a - b).abs().mean().item()


# One unit in the last place of half precision near 14 is 2^-7: where float32 and float64 fall on two sides of a
# rounding, two embeddings differ by that and no more.
ROUNDING = 2.0**-7
MEAN = 5e-6


def test_the_network_agrees_with_an_independent_one(ours: Tensor, pixels: Tensor, weights: dict[str, Tensor]) -> None:
    largest, mean = off(ours, reference(pixels, weights))

    assert largest <= ROUNDING
    assert mean < MEAN


@pytest.mark.parametrize("slip", naive.NETWORK_SLIPS)
def test_every_slip_would_be_seen(slip: str, ours: Tensor, pixels: Tensor, weights: dict[str, Tensor]) -> None:
    _, mean = off(ours, reference(pixels, weights, slip))

    assert mean > 4 * MEAN


@pytest.mark.parametrize("keep", [(1, 1), (17, 32), (48, 5), (30, 21)])
def test_keeping_a_part_changes_no_value_of_it(network: Network, pixels: Tensor, keep: tuple[int, int]) -> None:
    part = network(pixels, keep)

    assert part.shape[1:3] == keep
    largest, mean = off(part.float(), network(pixels)[:, : keep[0], : keep[1]].float())
    assert largest <= ROUNDING
    assert mean < MEAN


def test_a_grid_of_odd_sides_goes_through(network: Network) -> None:
    assert network(torch.zeros(1, 3, 80, 48)).shape == (1, 40, 24, small.SMALL.channels)
    assert network(torch.zeros(1, 3, 16, 48)).shape == (1, 8, 24, small.SMALL.channels)


@pytest.mark.parametrize(("dtype", "cosine"), [(torch.bfloat16, 0.98), (torch.float16, 0.999)])
def test_lower_precision_stays_near(
    weights: dict[str, Tensor], pixels: Tensor, ours: Tensor, dtype: torch.dtype, cosine: float
) -> None:
    low = small.network(weights).to(dtype)(pixels.to(dtype))[0].permute(2, 0, 1).double()

    assert torch.cosine_similarity(low, ours, dim=0).min() > cosine


@pytest.mark.parametrize(("source", "target"), [(48, 96), (5, 9), (1, 4), (6, 1), (7, 7)])
def test_enlarging_is_pytorchs_interpolation(source: int, target: int) -> None:
    maps = torch.rand(2, source, 6, 3)

    there = enlarge(maps, Axis.whole(source, target), Axis.whole(6, 11))

    expected = torch.nn.functional.interpolate(
        maps.permute(0, 3, 1, 2), size=(target, 11), mode="bilinear", align_corners=True
    )
    torch.testing.assert_close(there, expected.permute(0, 2, 3, 1))


def test_reach_is_as_far_as_is_read() -> None:
    maps = torch.rand(1, 48, 1, 1)
    for stop in range(1, 97):
        axis = Axis(48, 96, 0, stop)
        cut = enlarge(maps[:, : axis.reach], axis, Axis.whole(1, 1))
        assert torch.equal(cut, enlarge(maps, Axis.whole(48, 96), Axis.whole(1, 1))[:, :stop])


@pytest.mark.parametrize("gelu", [False, True])
def test_the_fast_dense_layer_is_the_plain_one(gelu: bool) -> None:
    x, weight, bias = torch.randn(2, 9, 32), torch.randn(64, 32), torch.randn(64)

    plain = torch.nn.functional.linear(x, weight, bias)

    expected = torch.nn.functional.gelu(plain) if gelu else plain
    torch.testing.assert_close(linear(x, weight, bias, gelu=gelu), expected, rtol=1e-5, atol=1e-5)
