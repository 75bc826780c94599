"""The training run: step, learning rate, averaged weights, checkpoints and the log."""

import copy
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.losses import WordLoss, likeness_loss, matched_cells, two_view_loss
from worker.encoders.compact_network import CompactNetwork

_HEADS = ("from16", "from8", "from4", "fuse", "refine", "words", "detail")
_WARM_UP = 0.03


@dataclass(frozen=True)
class Plan:
    """The numbers of a run.

    Attributes
    ----------
    minutes, steps
        The run ends, its learning rate having sunk to nothing, at whichever comes first; 0 means no limit.
    trunk_rate, head_rate
        Greatest learning rates.
    strong_word, words_two_view, detail_two_view, likeness
        Weights beside the word loss of the clear views: of the word loss under strongly changed light, and of the
        losses of two views.
    """

    minutes: float = 0.0
    steps: int = 0
    trunk_rate: float = 3e-4
    head_rate: float = 1e-3
    weight_decay: float = 0.01
    strong_word: float = 0.5
    words_two_view: float = 0.7
    detail_two_view: float = 0.5
    likeness: float = 5.0
    words_temperature: float = 0.1
    detail_temperature: float = 0.07
    averaging: float = 0.999
    log_every: int = 50
    checkpoint_every: int = 100

    def progress(self, step: int, seconds: float) -> float:
        """Say how much of the run is over, 0..1."""
        by_time = seconds / (60 * self.minutes) if self.minutes else 0.0
        by_steps = step / self.steps if self.steps else 0.0
        return max(by_time, by_steps)

    def rate(self, progress: float) -> float:
        """Give the learning rate as a share of its greatest value: a short warm-up, then a cosine to nothing."""
        rise = min(1.0, progress / _WARM_UP + 0.02)
        fall = max(0.0, progress - _WARM_UP) / (1 - _WARM_UP)
        return rise * (0.5 * (1 + math.cos(math.pi * min(1.0, fall))) + 0.002)


class Run:
    """A training run that can be stopped after any step and taken up again.

    Parameters
    ----------
    network
        What to train; changed in place.
    word_loss, anchor
        The supervised loss, and the frozen features whose likenesses the detail channel is held to.
    folder
        Gets ``checkpoint.pt`` and ``log.jsonl``.
    """

    def __init__(
        self,
        network: CompactNetwork,
        word_loss: WordLoss,
        anchor: nn.Module,
        plan: Plan,
        folder: Path,
        *,
        device: str = "cpu",
        half: bool = False,
    ) -> None:
        self.plan = plan
        self.device = torch.device(device)
        self.network = network.to(self.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = copy.deepcopy(network).eval().requires_grad_(False)
        self.word_loss = word_loss.to(self.device)
        self.anchor = anchor.to(self.device)
        self.step = 0
        self.seconds = 0.0
        self._half = half
        self._stopped = False
        self._folder = folder
        self._sums: dict[str, float] = {}
        heads = [p for name, p in network.named_parameters() if name.split(".")[0] in _HEADS]
        trunk = [p for name, p in network.named_parameters() if name.split(".")[0] not in _HEADS]
        self._rates = (plan.trunk_rate, plan.head_rate)
        self._optimizer = torch.optim.AdamW(
            [{"params": trunk}, {"params": heads}], lr=plan.trunk_rate, weight_decay=plan.weight_decay
        )

    def train(self, batches: Iterator[dict[str, Tensor]]) -> None:
        """Step until the plan is done or `stop` is called, leaving a checkpoint behind."""
        began = time.monotonic() - self.seconds
        while (progress := self.plan.progress(self.step, self.seconds)) < 1 and not self._stopped:
            self._take_step(next(batches), progress)
            self.seconds = time.monotonic() - began
            if self.step % self.plan.log_every == 0:
                self._log()
            if self.step % self.plan.checkpoint_every == 0:
                self.save()
        self.save()

    def stop(self) -> None:
        """End `train` after the step at hand, leaving a checkpoint to go on from."""
        self._stopped = True

    def losses(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Compute each loss of one batch, and the shares of cells found again."""
        batch = {name: tensor.to(self.device) for name, tensor in batch.items()}
        pictures = batch["pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        mild = batch["mild"].repeat(2)
        clear = batch["clear_pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self._half):
            at4, at8 = self.network.shallow(pictures)
            joined = self.network.fused(at4[~mild], at8[~mild])
            detail = self.network.appearance(at4[mild], at8[mild])
            with torch.no_grad():
                before = self.anchor(pictures[mild])
            clear_at4, clear_at8 = self.network.shallow(clear)
            sharp = self.network.refine(clear_at4, self.network.fused(clear_at4, clear_at8))
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
        likeness = likeness_loss(here, there, *earlier)
        return {
            "clear_word": self.word_loss(sharp.float(), head, batch["clear_meanings"], batch["clear_sets"]),
            "word": self.word_loss(joined, head, batch["meanings"][~mild], batch["sets"][~mild]),
            "words_two_view": words_loss,
            "detail_two_view": detail_loss,
            "likeness": likeness,
            "words_found": words_found,
            "detail_found": detail_found,
        }

    def _take_step(self, batch: dict[str, Tensor], progress: float) -> None:
        for group, greatest in zip(self._optimizer.param_groups, self._rates, strict=True):
            group["lr"] = greatest * self.plan.rate(progress)
        losses = self.losses(batch)
        total = (
            losses["clear_word"]
            + self.plan.strong_word * losses["word"]
            + self.plan.words_two_view * losses["words_two_view"]
            + self.plan.detail_two_view * losses["detail_two_view"]
            + self.plan.likeness * losses["likeness"]
        )
        self._optimizer.zero_grad(set_to_none=True)
        total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self._optimizer.step()
        self.step += 1
        with torch.no_grad():
            keep = min(self.plan.averaging, self.step / (self.step + 20))
            for averaged, current in zip(self.average.parameters(), self.network.parameters(), strict=True):
                averaged.lerp_(current, 1 - keep)
        for name, loss in losses.items():
            self._sums[name] = self._sums.get(name, 0.0) + loss.item()

    def _log(self) -> None:
        line = {"step": self.step, "minutes": round(self.seconds / 60, 2)}
        line |= {name: round(total / self.plan.log_every, 4) for name, total in self._sums.items()}
        self._sums = {}
        with (self._folder / "log.jsonl").open("a") as log:
            log.write(json.dumps(line) + "\n")

    def save(self) -> None:
        """Write ``checkpoint.pt``, whole or not at all."""
        content: dict[str, Any] = {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "sums": self._sums,
            "step": self.step,
            "seconds": self.seconds,
            "plan": asdict(self.plan),
            "random": torch.get_rng_state(),
        }
        path = self._folder / "checkpoint.pt"
        partial = path.with_suffix(".partial")
        torch.save(content, partial)
        partial.replace(path)

    def resume(self) -> None:
        """Take up the run that `save` wrote; the plan may have changed since."""
        content = torch.load(self._folder / "checkpoint.pt", map_location=self.device, weights_only=True)
        self.network.load_state_dict(content["network"])
        self.average.load_state_dict(content["average"])
        self._optimizer.load_state_dict(content["optimizer"])
        self._sums, self.step, self.seconds = content["sums"], content["step"], content["seconds"]
        torch.set_rng_state(content["random"].cpu())


def _unit_points(points: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    here, there = points
    return F.normalize(here, dim=2), F.normalize(there, dim=2)
