"""Multiply-adds, counted by hand and by PyTorch."""

import pytest
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

from lab.benchmarks.lseg_cost import multiply_adds
from tests.encoders.lseg import small
from worker.encoders.lseg import linear
from worker.encoders.lseg.config import PUBLISHED


def test_the_transformer_of_one_published_window() -> None:
    """901 tokens through 24 blocks of 12 x 1024^2, and two products of 901 x 901 x 1024 for attention."""
    embedding = 900 * 768 * 1024
    block = 901 * 12_582_912 + 2 * 811_801 * 1024

    assert multiply_adds(PUBLISHED, (480, 480))["transformer"] == embedding + 24 * block


@pytest.mark.parametrize("size", [(96, 96), (80, 48), (32, 112)])
@pytest.mark.parametrize("keep", [None, (7, 9)])
def test_pytorch_counts_the_same(
    size: tuple[int, int], keep: tuple[int, int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The counter knows PyTorch's plain products only, neither oneDNN's nor those within fused attention.
    monkeypatch.setattr(linear, "onednn_is_faster", lambda: False)
    counter = FlopCounterMode(display=False)
    with counter, torch.inference_mode(), sdpa_kernel(SDPBackend.MATH):
        small.network(small.state())(torch.zeros(1, 3, *size), keep)

    assert 2 * sum(multiply_adds(small.SMALL, size, keep).values()) == counter.get_total_flops()
