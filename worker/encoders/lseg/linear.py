"""Dense layers, by the fastest routine this processor has for them."""

import functools

import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor


@functools.cache
def onednn_is_faster() -> bool:
    """Whether float32 products should go to oneDNN rather than to the BLAS that PyTorch was built with.

    PyTorch's x86 wheels multiply float32 matrices with MKL, which keeps to AVX2 on processors of other makers;
    oneDNN, which the same wheels carry for convolutions, uses AVX-512 wherever there is AVX-512, and was 1.5 to 2
    times faster on an AMD EPYC. The operator is the one that torch.compile emits for a linear layer; it has no
    public name, hence the check that it is there.
    """
    return (
        torch.backends.cpu.get_cpu_capability().startswith("AVX512")
        and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        and hasattr(torch.ops.mkldnn, "_linear_pointwise")
    )


def linear(x: Tensor, weight: Tensor, bias: Tensor | None = None, *, gelu: bool = False) -> Tensor:
    """``x W^T + b``, followed by the exact (erf) GELU if `gelu`.

    Parameters
    ----------
    x : (..., inputs)
    weight : (outputs, inputs)
    bias : (outputs,) or None
    gelu : bool
        Apply x Phi(x), Phi being the normal distribution function.

    Returns
    -------
    (..., outputs)
    """
    if x.device.type == "cpu" and x.dtype == torch.float32 and not x.requires_grad and onednn_is_faster():
        after = "gelu" if gelu else "none"
        fused: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, after, [], "none" if gelu else "")
        return fused
    y = F.linear(x, weight, bias)
    return F.gelu(y) if gelu else y
