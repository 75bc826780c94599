"""The losses of a run that trains the distilled head: a frozen network below it, a teacher's tokens beside it."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.loop import Plan
from training.losses.two_view import matched_cells, two_view_loss
from training.models.distilled_head import DistilledHead, layers_below
from worker.encoders.compact.network import CompactNetwork


@dataclass(frozen=True)
class DistilledPlan(Plan):
    """The numbers of a run that trains the distilled head.

    Attributes
    ----------
    two_view_weight : float
        Weight of the two-view loss; that of the distance from the teacher is 1.
    temperature : float
        What cosines are divided by in the two-view loss.
    """

    two_view_weight: float = 0.1
    temperature: float = 0.1


class DistilledLosses(nn.Module):
    """The losses of the distilled head on a batch of `training.data.crop_batches.CropBatches`.

    The teacher saw the clean crop and the network the augmented one: it learns to see through night and snow what the
    teacher sees by day (Hinton, Vinyals and Dean 2015; Ranzinger et al. 2024, "AM-RADIO", for dense tokens).

    Parameters
    ----------
    network : CompactNetwork
        Stays as it is.
    head : DistilledHead
        What is trained.
    plan : DistilledPlan
    """

    def __init__(self, network: CompactNetwork, head: DistilledHead, plan: DistilledPlan) -> None:
        super().__init__()
        self.network, self.head, self.plan = network, head, plan

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of the losses, and what to log: the losses, and the two-view accuracy."""
        images = batch["images"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.plan.half):
            with torch.no_grad():
                below = layers_below(self.network, images)
            field = self.head(*below)
        field = F.normalize(field.float(), dim=1)
        distance = 1 - (field * batch["targets"].float()).sum(dim=1).mean()
        matched = batch["matched"]
        cells, positions = batch["cells"][matched], batch["positions"][matched]
        here, there = matched_cells(field[matched.repeat(2)], cells, positions)
        here, there = F.normalize(here, dim=2), F.normalize(there, dim=2)
        two_view, accuracy = two_view_loss(here, there, cells, field.shape[-1], self.plan.temperature, margin=1)
        total = distance + self.plan.two_view_weight * two_view
        return total, {"distance": distance, "two_view": two_view, "accuracy": accuracy}
