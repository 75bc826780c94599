import torch

from training.losses.distilled import DistilledLosses, DistilledPlan
from training.models.distilled_head import DISTILLED_CHANNELS, DistilledHead, layers_below
from worker.encoders.compact.network import CompactNetwork, for_inference


def batch() -> dict[str, torch.Tensor]:
    images = torch.randint(0, 255, (4, 3, 64, 96), dtype=torch.uint8)
    targets = torch.nn.functional.normalize(torch.randn(4, DISTILLED_CHANNELS, 4, 6), dim=1)
    cells = torch.arange(8).repeat(2, 1)
    positions = torch.rand(2, 8, 2) * 2 - 1
    return {
        "images": images,
        "targets": targets.half(),
        "cells": cells,
        "positions": positions,
        "matched": torch.tensor([True, False]),
    }


def test_the_head_learns_and_the_network_below_stays_as_it_is() -> None:
    torch.manual_seed(0)
    small = CompactNetwork()
    network = for_inference(CompactNetwork(), small.state_dict())
    head = DistilledHead(channels=16, blocks=1)
    losses = DistilledLosses(network, head, DistilledPlan())
    optimizer = torch.optim.Adam(head.parameters(), 3e-3)
    given = batch()

    seen = []
    for _ in range(12):
        total, logged = losses(given)
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        seen.append(logged["distance"].item())

    assert seen[-1] < seen[0] - 0.02
    assert all(torch.equal(mine, small.state_dict()[name]) for name, mine in network.state_dict().items())


def test_fields_are_half_as_fine_as_the_networks_whatever_the_size() -> None:
    network, head = for_inference(CompactNetwork(), CompactNetwork().state_dict()), DistilledHead(channels=16, blocks=2)

    for height, width in ((96, 128), (120, 72)):
        at8, at16 = layers_below(network, torch.rand(1, 3, height, width))
        assert at8.shape[2:] == (-(-height // 8), -(-width // 8))
        assert head(at8, at16).shape == (1, DISTILLED_CHANNELS, -(-height // 16), -(-width // 16))
