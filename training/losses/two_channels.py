"""What the two channels are trained for: words near their text, cells found again, similarities kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.loop import Plan
from training.losses.label_loss import WordLoss
from training.losses.two_view import matched_cells, similarity_loss, two_view_loss
from training.models.network import TrainedNetwork


@dataclass(frozen=True)
class TwoChannelPlan(Plan):
    """The numbers of a run that trains both channels.

    Attributes
    ----------
    strong_word, words_two_view, detail_two_view, similarity
        Weights beside the word loss of the clear views: of the word loss under strongly changed light, and of the
        losses of two views.
    """

    strong_word: float = 0.5
    words_two_view: float = 0.7
    detail_two_view: float = 0.5
    similarity: float = 5.0
    words_temperature: float = 0.1
    detail_temperature: float = 0.07


class TwoChannels(nn.Module):
    """The losses of both channels on a batch of `training.data.batches.Batches`.

    Parameters
    ----------
    network
        What is trained.
    word_loss, anchor
        The supervised loss, and the frozen features whose similarities the detail channel is held to.
    """

    def __init__(self, network: TrainedNetwork, word_loss: WordLoss, anchor: nn.Module, plan: TwoChannelPlan) -> None:
        super().__init__()
        self.network, self.word_loss, self.anchor, self.plan = network, word_loss, anchor, plan

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of a batch's losses; and each of them, and the shares of cells found again."""
        losses = self.losses(batch)
        total = (
            losses["clear_word"]
            + self.plan.strong_word * losses["word"]
            + self.plan.words_two_view * losses["words_two_view"]
            + self.plan.detail_two_view * losses["detail_two_view"]
            + self.plan.similarity * losses["likeness"]
        )
        return total, losses

    def losses(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Compute each loss of one batch, and the shares of cells found again."""
        images = batch["pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        mild = batch["mild"].repeat(2)
        clear = batch["clear_pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.plan.half):
            at4, at8 = self.network.shallow(images)
            joined = self.network.fused(at4[~mild], at8[~mild])
            detail = self.network.appearance(at4[mild], at8[mild])
            with torch.no_grad():
                before = self.anchor(images[mild])
            sharp = self.network.sharp(clear)
        joined, head = joined.float(), self.network.words
        detail = F.normalize(detail.float(), dim=1)
        columns = joined.shape[-1]

        strong = batch["matched"] & ~batch["mild"]
        pairs = strong[~batch["mild"]].repeat(2)
        cells, positions = batch["cells"][strong], batch["positions"][strong]
        matched = matched_cells(joined[pairs], cells, positions)
        here, there = _unit_points([F.linear(at, head.weight.flatten(1), head.bias) for at in matched])
        words_loss, words_found = two_view_loss(here, there, cells, columns, self.plan.words_temperature, margin=2)
        gentle = batch["matched"] & batch["mild"]
        pairs = gentle[batch["mild"]].repeat(2)
        cells, positions = batch["cells"][gentle], batch["positions"][gentle]
        here, there = _unit_points(matched_cells(detail[pairs], cells, positions))
        detail_loss, detail_found = two_view_loss(here, there, cells, columns, self.plan.detail_temperature, margin=1)
        earlier = _unit_points(matched_cells(before.float()[pairs], cells, positions))
        similarity = similarity_loss(here, there, *earlier)
        return {
            "clear_word": self.word_loss(sharp.float(), head, batch["clear_meanings"], batch["clear_sets"]),
            "word": self.word_loss(joined, head, batch["meanings"][~mild], batch["sets"][~mild]),
            "words_two_view": words_loss,
            "detail_two_view": detail_loss,
            "likeness": similarity,
            "words_found": words_found,
            "detail_found": detail_found,
        }


def _unit_points(points: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    here, there = points
    return F.normalize(here, dim=2), F.normalize(there, dim=2)
