import pytest
import torch
from torch import Tensor, nn

from training.models.depthwise import FastDepthwise, use_fast_depthwise
from worker.encoders.compact.network import CompactNetwork

KERNELS = [(5, 1), (3, 2), (5, 2)]
"""Kernel and dilation of the convolutions that torch is slow with."""


def quick_and_plain(kernel: int, dilation: int) -> tuple[nn.Module, nn.Conv2d]:
    torch.manual_seed(0)
    plain = nn.Conv2d(6, 6, kernel, padding=(kernel - 1) * dilation // 2, dilation=dilation, groups=6)
    quick = nn.Conv2d(6, 6, kernel, padding=(kernel - 1) * dilation // 2, dilation=dilation, groups=6)
    quick.load_state_dict(plain.state_dict())
    use_fast_depthwise(quick)
    assert isinstance(quick, FastDepthwise)
    return quick, plain


def value_and_gradients(convolution: nn.Module, maps: Tensor) -> list[Tensor]:
    """The convolved maps, and the gradients of their sum of squares by maps, weight and bias."""
    maps = maps.clone().requires_grad_()
    convolved = convolution(maps)
    return [
        convolved.detach(),
        *torch.autograd.grad(convolved.float().square().sum(), [maps, *convolution.parameters()]),
    ]


@pytest.mark.parametrize(("kernel", "dilation"), KERNELS)
def test_value_and_gradients_are_those_of_the_plain_convolution(kernel: int, dilation: int) -> None:
    quick, plain = quick_and_plain(kernel, dilation)
    maps = torch.randn(2, 6, 9, 11)

    for one, other in zip(value_and_gradients(quick, maps), value_and_gradients(plain, maps), strict=True):
        assert torch.allclose(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("kernel", "dilation"), KERNELS)
def test_under_autocast_they_are_as_near_as_bfloat16_allows(kernel: int, dilation: int) -> None:
    quick, plain = quick_and_plain(kernel, dilation)
    maps = torch.randn(2, 6, 9, 11)
    exact = value_and_gradients(plain, maps)

    with torch.autocast("cpu", torch.bfloat16):
        rounded = value_and_gradients(quick, maps)

    assert [tensor.dtype for tensor in rounded] == [torch.bfloat16, *[torch.float32] * 3]
    for one, other in zip(rounded, exact, strict=True):
        assert float((one.float() - other).abs().max()) < 0.03 * float(other.abs().max())


def test_only_slow_convolutions_of_the_network_are_replaced_and_nothing_else_changes() -> None:
    torch.manual_seed(0)
    network = CompactNetwork().eval()
    names, image = list(network.state_dict()), torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        before = network(image)

    use_fast_depthwise(network)

    quick = {name for name, module in network.named_modules() if isinstance(module, FastDepthwise)}
    assert {name.split(".")[0] for name in quick} == {"deep", "context"}
    assert list(network.state_dict()) == names
    with torch.no_grad():
        for one, other in zip(network(image), before, strict=True):
            assert torch.allclose(one, other, atol=1e-6)
