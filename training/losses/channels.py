"""The losses of a run that trains the semantic and the detail channel together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.loop import Plan
from training.losses.label_loss import LabelLoss
from training.losses.two_view import matched_cells, similarity_loss, two_view_loss
from training.models.network import TrainedNetwork


@dataclass(frozen=True)
class ChannelPlan(Plan):
    """The numbers of a run that trains both channels.

    Attributes
    ----------
    strong_label_weight, semantic_two_view_weight, detail_two_view_weight, similarity_weight : float
        Weights of the label loss under strong augmentation and of the losses over two views. The label loss of the
        labelled views has weight 1.
    semantic_temperature, detail_temperature : float
        What cosines are divided by in the two-view losses.
    """

    strong_label_weight: float = 0.5
    semantic_two_view_weight: float = 0.7
    detail_two_view_weight: float = 0.5
    similarity_weight: float = 5.0
    semantic_temperature: float = 0.1
    detail_temperature: float = 0.07


class ChannelLosses(nn.Module):
    """The losses of both channels on a batch of `training.data.batches.Batches`.

    Parameters
    ----------
    network : TrainedNetwork
        What is trained.
    label_loss : LabelLoss
    teacher_features : Module
        RGB images in 0..1 to unit-length features at stride 8, frozen: the detail channel keeps their cosines.
    plan : ChannelPlan
    """

    def __init__(
        self, network: TrainedNetwork, label_loss: LabelLoss, teacher_features: nn.Module, plan: ChannelPlan
    ) -> None:
        super().__init__()
        self.network, self.label_loss, self.teacher_features, self.plan = network, label_loss, teacher_features, plan

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of a batch's losses, and all that `losses` gives."""
        losses = self.losses(batch)
        total = (
            losses["label"]
            + self.plan.strong_label_weight * losses["strong_label"]
            + self.plan.semantic_two_view_weight * losses["semantic_two_view"]
            + self.plan.detail_two_view_weight * losses["detail_two_view"]
            + self.plan.similarity_weight * losses["similarity"]
        )
        return total, losses

    def losses(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Compute each loss of one batch, and the two-view accuracy of either channel."""
        images = batch["images"].float().div(255).contiguous(memory_format=torch.channels_last)
        mild = batch["mild"].repeat(2)
        labelled = batch["labelled_images"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.plan.half):
            at4, at8 = self.network.shallow(images)
            joined = self.network.fused(at4[~mild], at8[~mild])
            detail = self.network.appearance(at4[mild], at8[mild])
            with torch.no_grad():
                teacher = self.teacher_features(images[mild])
            refined = self.network.refined(labelled)
        joined, head = joined.float(), self.network.words
        detail = F.normalize(detail.float(), dim=1)
        columns = joined.shape[-1]

        strong_pairs = batch["matched"] & ~batch["mild"]
        pairs = strong_pairs[~batch["mild"]].repeat(2)
        cells, positions = batch["cells"][strong_pairs], batch["positions"][strong_pairs]
        matched = matched_cells(joined[pairs], cells, positions)
        here, there = _unit_length([F.linear(at, head.weight.flatten(1), head.bias) for at in matched])
        temperature = self.plan.semantic_temperature
        semantic_loss, semantic_accuracy = two_view_loss(here, there, cells, columns, temperature, margin=2)

        mild_pairs = batch["matched"] & batch["mild"]
        pairs = mild_pairs[batch["mild"]].repeat(2)
        cells, positions = batch["cells"][mild_pairs], batch["positions"][mild_pairs]
        here, there = _unit_length(matched_cells(detail[pairs], cells, positions))
        temperature = self.plan.detail_temperature
        detail_loss, detail_accuracy = two_view_loss(here, there, cells, columns, temperature, margin=1)
        of_teacher = _unit_length(matched_cells(teacher.float()[pairs], cells, positions))
        return {
            "label": self.label_loss(refined.float(), head, batch["labelled_classes"], batch["labelled_sets"]),
            "strong_label": self.label_loss(joined, head, batch["classes"][~mild], batch["sets"][~mild]),
            "semantic_two_view": semantic_loss,
            "detail_two_view": detail_loss,
            "similarity": similarity_loss(here, there, *of_teacher),
            "semantic_accuracy": semantic_accuracy,
            "detail_accuracy": detail_accuracy,
        }


def _unit_length(points: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    here, there = points
    return F.normalize(here, dim=2), F.normalize(there, dim=2)
