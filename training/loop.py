"""The training loop: steps, learning rate, averaged weights, checkpoints and the log."""

import copy
import json
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn

_HEADS = frozenset(("from16", "from8", "from4", "fuse", "refine", "sharpen", "words", "detail"))
"""Names of modules that learn at the head rate; all others learn at the trunk rate."""

_WARM_UP = 0.03

CHECKPOINT = "checkpoint.pt"
"""Name of the file in a run's folder that it can go on from."""


@dataclass(frozen=True)
class Plan:
    """The numbers that every run has.

    Attributes
    ----------
    minutes : float
    steps : int
        The run ends at whichever comes first; 0 means no limit. Its learning rate has then sunk to nearly 0.
    trunk_rate, head_rate : float
        Greatest learning rates of the pretrained layers and of the heads.
    weight_decay : float
    averaging : float
        Share of the averaged weights that a step keeps.
    log_every, checkpoint_every : int
        Steps.
    half : bool
        Compute in bfloat16 where autocast does.
    """

    minutes: float = 0.0
    steps: int = 0
    trunk_rate: float = 3e-4
    head_rate: float = 1e-3
    weight_decay: float = 0.01
    averaging: float = 0.999
    log_every: int = 50
    checkpoint_every: int = 100
    half: bool = False

    def progress(self, step: int, seconds: float) -> float:
        """Give the share of the run that is over, 0..1; more than 1 past its end."""
        by_time = seconds / (60 * self.minutes) if self.minutes else 0.0
        by_steps = step / self.steps if self.steps else 0.0
        return max(by_time, by_steps)

    def rate(self, progress: float) -> float:
        """Give the learning rate as a share of its greatest value: a short warm-up, then a cosine to nearly 0."""
        rise = min(1.0, progress / _WARM_UP + 0.02)
        fall = max(0.0, progress - _WARM_UP) / (1 - _WARM_UP)
        return rise * (0.5 * (1 + math.cos(math.pi * min(1.0, fall))) + 0.002)


class Objective(Protocol):
    """What a run minimises: a `torch.nn.Module` that holds the network and its losses."""

    def __call__(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the scalar to minimise, and the scalars to log."""
        ...

    def to(self, device: torch.device) -> "Objective":
        """Move to a device."""
        ...


class Run:
    """A training run that can be stopped after any step and resumed.

    Parameters
    ----------
    network : Module
        What to train; changed in place. Parameters that need no gradient stay as they are.
    objective : Objective
        Moved to the device.
    plan : Plan
    folder : Path
        Gets ``checkpoint.pt`` and ``log.jsonl``.
    device : str
        ``cpu``, ``cuda``, ...

    Attributes
    ----------
    average : Module
        The network with exponentially averaged weights: what is exported.
    step : int
        Steps taken.
    seconds : float
        Time spent training, without pauses.
    """

    def __init__(
        self,
        network: nn.Module,
        objective: Objective,
        plan: Plan,
        folder: Path,
        *,
        device: str = "cpu",
    ) -> None:
        self.plan = plan
        self.device = torch.device(device)
        self.network = network.to(self.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = copy.deepcopy(network).eval().requires_grad_(False)
        self.objective = objective.to(self.device)
        self.step = 0
        self.seconds = 0.0
        self._stopped = False
        self._folder = folder
        self._sums: dict[str, float] = {}
        heads = [p for name, p in network.named_parameters() if not _HEADS.isdisjoint(name.split("."))]
        trunk = [p for name, p in network.named_parameters() if _HEADS.isdisjoint(name.split("."))]
        self._rates = (plan.trunk_rate, plan.head_rate)
        self._optimizer = torch.optim.AdamW(
            [{"params": trunk}, {"params": heads}], lr=plan.trunk_rate, weight_decay=plan.weight_decay
        )

    def train(self, batches: Iterator[dict[str, Tensor]]) -> None:
        """Take steps until the plan is done or `stop` is called; leaves a checkpoint."""
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
        """End `train` after the present step; it leaves a checkpoint to resume from."""
        self._stopped = True

    def _take_step(self, batch: dict[str, Tensor], progress: float) -> None:
        for group, greatest in zip(self._optimizer.param_groups, self._rates, strict=True):
            group["lr"] = greatest * self.plan.rate(progress)
        total, losses = self.objective({name: tensor.to(self.device) for name, tensor in batch.items()})
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
        """Write ``checkpoint.pt``, whole or not at all.

        It holds ``network``, ``average`` and ``optimizer`` (state dicts), ``sums`` (of the losses not yet logged),
        ``step``, ``seconds``, ``plan`` and ``random`` (torch's state).
        """
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
        path = self._folder / CHECKPOINT
        partial = path.with_suffix(".partial")
        torch.save(content, partial)
        partial.replace(path)

    def resume(self) -> None:
        """Go on with the run that `save` wrote; the plan may have changed since.

        What was logged after that goes: those steps are taken, and logged, again.
        """
        content = torch.load(self._folder / CHECKPOINT, map_location=self.device, weights_only=True)
        self.network.load_state_dict(content["network"])
        self.average.load_state_dict(content["average"])
        self._optimizer.load_state_dict(content["optimizer"])
        self._sums, self.step, self.seconds = content["sums"], content["step"], content["seconds"]
        torch.set_rng_state(content["random"].cpu())
        log = self._folder / "log.jsonl"
        if log.exists():
            # The last line may have been cut off while it was written.
            kept = [line for line in log.read_text().splitlines(keepends=True) if _step_of(line) <= self.step]
            partial = log.with_suffix(".partial")
            partial.write_text("".join(kept))
            partial.replace(log)


def _step_of(line: str) -> float:
    """The step of a line of the log; infinite where it is not whole."""
    try:
        return float(json.loads(line)["step"])
    except ValueError:
        return math.inf
