"""The losses of a run that trains a segmentation network."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.loop import Plan
from training.losses.distillation import DistillationLoss
from training.losses.label_loss import LabelLoss
from training.losses.pixel_sampling import draw_pixels, interpolate_at, sample_source
from worker.encoders.compact.network import ShallowLayers
from worker.encoders.compact.segmentation import SegmentationNetwork


@dataclass(frozen=True)
class SegmentationPlan(Plan):
    """The numbers of a run that trains a segmentation network.

    Attributes
    ----------
    shared : str
        `training.models.checkpoints.shared_digest` of the exported network that the run began with.
    class_weight_power : float
        A pixel's weight is its class's share of all labelled pixels to this power.
    soft_iou_weight, distillation_weight : float
        Weights of these losses; that of the cross-entropy is 1.
    pixels : int
        How many pixels are drawn of each view.
    """

    shared: str = ""
    class_weight_power: float = -0.25
    soft_iou_weight: float = 2.0
    distillation_weight: float = 0.5
    pixels: int = 3072


class SegmentationLosses(nn.Module):
    """The losses of a segmentation network on the labelled views of `training.data.batches.Batches`.

    Parameters
    ----------
    shallow : ShallowLayers
        Gives the levels that `network` reads. They are trained as far as their parameters want gradients.
    network : SegmentationNetwork
    label_loss : LabelLoss
    distillation_loss : DistillationLoss
    plan : SegmentationPlan
    """

    def __init__(
        self,
        shallow: ShallowLayers,
        network: SegmentationNetwork,
        label_loss: LabelLoss,
        distillation_loss: DistillationLoss,
        plan: SegmentationPlan,
    ) -> None:
        super().__init__()
        self.shallow, self.network, self.plan = shallow, network, plan
        self.label_loss, self.distillation_loss = label_loss, distillation_loss

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of the losses, and each of them."""
        images = batch["labelled_images"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.plan.half):
            joined = self.network.joined(*self.shallow.levels(images))
        head = self.network.words
        cells = F.linear(joined.float().permute(0, 2, 3, 1), head.weight.flatten(1), head.bias)

        classes, sets = batch["labelled_classes"], batch["labelled_sets"]
        size = (classes.shape[1], classes.shape[2])
        pixels = draw_pixels(len(images), size, self.plan.pixels, images.device)
        embeddings = interpolate_at(F.normalize(cells, dim=3), pixels, size)
        target, owner = classes[pixels.view, pixels.row, pixels.column].long(), sets[pixels.view]
        labelled = (target >= 0) & (owner >= 0)
        entropy, soft_iou = self.label_loss.with_soft_iou(embeddings[labelled], target[labelled], owner[labelled])
        soft_labels, inside = sample_source(batch["soft_labels"].float(), batch["to_source"], pixels, size)
        distillation = self.distillation_loss(embeddings[inside], soft_labels[inside], target[inside])
        total = entropy + self.plan.soft_iou_weight * soft_iou + self.plan.distillation_weight * distillation
        return total, {"label": entropy, "soft_iou": soft_iou, "distillation": distillation}
