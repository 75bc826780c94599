"""Depthwise convolutions whose gradients are fast on a CPU.

On a CPU, torch's gradients of large or dilated depthwise convolutions take many times as long as the convolutions. Here
the gradient by the input is itself a depthwise convolution, with the kernel turned by 180 degrees, and the gradient by
each tap of the kernel is the sum of a product of two shifted maps; the layers of this network then take three quarters
of the time (docs/model-card.md).
"""

from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


class _Depthwise(torch.autograd.Function):
    """Depthwise convolution with an odd kernel, stride 1, padded to keep the size."""

    @staticmethod
    def forward(ctx: Any, maps: Tensor, weight: Tensor, bias: Tensor, dilation: int) -> Tensor:
        ctx.save_for_backward(maps, weight)
        ctx.dilation = dilation
        return F.conv2d(maps, weight, bias, 1, _reach(weight, dilation), dilation, weight.shape[0])

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        maps, weight = ctx.saved_tensors
        reach, dilation = _reach(weight, ctx.dilation), ctx.dilation
        gradient = gradient.contiguous(memory_format=torch.channels_last)
        by_maps = F.conv2d(gradient, weight.flip(2, 3), None, 1, reach, dilation, weight.shape[0])
        height, width = maps.shape[-2:]
        padded = F.pad(maps, (reach, reach, reach, reach))
        taps = [
            (gradient * padded[:, :, row : row + height, column : column + width]).sum((0, 2, 3), dtype=torch.float32)
            for row in range(0, 2 * reach + 1, dilation)
            for column in range(0, 2 * reach + 1, dilation)
        ]
        by_weight = torch.stack(taps, dim=1).view(weight.shape).to(weight.dtype)
        by_bias = gradient.sum((0, 2, 3), dtype=torch.float32).to(weight.dtype)
        return by_maps, by_weight, by_bias, None


class FastDepthwise(nn.Conv2d):
    """A depthwise `Conv2d` of stride 1 with the same parameters, under the same names."""

    def forward(self, maps: Tensor) -> Tensor:
        """Convolve as `Conv2d` does, in autocast's type where it is on."""
        assert self.bias is not None
        kind = torch.get_autocast_dtype(maps.device.type) if torch.is_autocast_enabled(maps.device.type) else maps.dtype
        given = (maps.to(kind), self.weight.to(kind), self.bias.to(kind))
        convolved: Tensor = _Depthwise.apply(*given, int(self.dilation[0]))  # type: ignore[no-untyped-call]
        return convolved


def use_fast_depthwise(network: nn.Module) -> None:
    """Give a network's depthwise convolutions, in place, gradients that are fast on a CPU.

    Only those of stride 1 that are dilated or larger than 3 x 3; torch is fast with the others.
    """
    for module in network.modules():
        if not isinstance(module, nn.Conv2d) or module.groups == 1 or module.groups != module.in_channels:
            continue
        if module.stride == (1, 1) and (module.kernel_size > (3, 3) or module.dilation > (1, 1)):
            module.__class__ = FastDepthwise


def _reach(weight: Tensor, dilation: int) -> int:
    return int((weight.shape[-1] - 1) * dilation // 2)
