import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from training.data.batches import Batches, stream
from training.data.lexicon import Lexicon
from training.data.mix import Mix
from training.data.sources import find_sources
from training.loop import Run
from training.losses.channels import ChannelLosses, ChannelPlan
from training.losses.label_loss import LabelLoss
from training.models.network import TrainedNetwork

MIX = Mix(strong=2, mild=2, labelled=2, size=(64, 96), labelled_size=(64, 96))
PLAN = ChannelPlan(steps=4, log_every=2, checkpoint_every=100)


def run_in(folder: Path, data_folder: Path, lexicon: Lexicon, plan: ChannelPlan = PLAN) -> tuple[Run, Batches]:
    torch.manual_seed(0)
    folder.mkdir(exist_ok=True)
    label_loss = LabelLoss(
        torch.from_numpy(lexicon.vectors),
        torch.from_numpy(lexicon.allowed()),
        torch.from_numpy(lexicon.competing()),
        torch.ones(len(lexicon.classes)),
        temperature=0.07,
    )
    teacher_features = nn.Conv2d(3, 8, 8, stride=8).requires_grad_(False)
    network = TrainedNetwork()
    run = Run(network, ChannelLosses(network, label_loss, teacher_features, plan), plan, folder)
    return run, Batches(find_sources(data_folder, None), lexicon, MIX, seed=5)


def values(run: Run, batch: dict[str, Tensor]) -> dict[str, float]:
    return {name: loss.item() for name, loss in run.objective(batch)[1].items()}


def stopping_after_two(run: Run, batches: Iterator[dict[str, Tensor]]) -> Iterator[dict[str, Tensor]]:
    yield next(batches)
    run.stop()
    yield next(batches)


def test_a_batch_depends_on_seed_and_step_alone(data_folder: Path, lexicon: Lexicon, tmp_path: Path) -> None:
    _, batches = run_in(tmp_path, data_folder, lexicon)

    again, other = batches[7], batches[8]

    assert all(torch.equal(tensor, again[name]) for name, tensor in batches[7].items())
    assert not torch.equal(again["images"], other["images"])


def test_the_loss_sinks_on_a_batch_seen_again_and_again(data_folder: Path, lexicon: Lexicon, tmp_path: Path) -> None:
    run, batches = run_in(tmp_path, data_folder, lexicon, dataclasses.replace(PLAN, steps=20, trunk_rate=1e-3))
    names = ("label", "strong_label", "semantic_two_view", "detail_two_view")
    # Not every small batch has something to teach by each loss: labels under strong augmentation, cells in both views.
    batch = next(b for b in map(batches.__getitem__, range(50)) if min(values(run, b)[name] for name in names) > 0)
    before = values(run, batch)

    run.train(iter([batch] * 20))

    after = values(run, batch)
    for name in names:
        assert after[name] < before[name]


def test_a_resumed_run_takes_the_steps_that_the_whole_run_takes(
    data_folder: Path, lexicon: Lexicon, tmp_path: Path
) -> None:
    whole, batches = run_in(tmp_path / "whole", data_folder, lexicon)
    whole.train(stream(batches, 0, workers=0))

    stopped, batches = run_in(tmp_path / "halves", data_folder, lexicon)
    stopped.train(stopping_after_two(stopped, stream(batches, 0, workers=0)))
    assert stopped.step == 2
    resumed, batches = run_in(tmp_path / "halves", data_folder, lexicon)
    resumed.resume()
    resumed.train(stream(batches, resumed.step, workers=0))

    assert resumed.step == whole.step == 4
    for (name, one), other in zip(
        whole.average.state_dict().items(), resumed.average.state_dict().values(), strict=True
    ):
        assert torch.allclose(one, other, atol=1e-6), name


def test_the_log_has_a_line_of_mean_losses_every_few_steps(data_folder: Path, lexicon: Lexicon, tmp_path: Path) -> None:
    run, batches = run_in(tmp_path, data_folder, lexicon)

    run.train(stream(batches, 0, workers=0))

    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4]
    assert {"label", "strong_label", "semantic_two_view", "detail_two_view", "similarity"} <= lines[0].keys()


def test_a_run_that_was_killed_logs_each_step_once(data_folder: Path, lexicon: Lexicon, tmp_path: Path) -> None:
    run, batches = run_in(tmp_path, data_folder, lexicon)
    run.save()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "save", lambda: None)  # killed before the next checkpoint
        run.train(stream(batches, 0, workers=0))
    with (tmp_path / "log.jsonl").open("a") as log:
        log.write('{"step": 6, "minu')

    resumed, batches = run_in(tmp_path, data_folder, lexicon)
    resumed.resume()
    resumed.train(stream(batches, resumed.step, workers=0))

    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4]


@pytest.mark.parametrize("progress", [0.0, 0.01, 0.03, 0.5, 1.0])
def test_the_learning_rate_rises_briefly_and_sinks_to_nothing(progress: float) -> None:
    rate = PLAN.rate(progress)

    assert 0 < rate <= 1.003
    assert PLAN.rate(1.0) < 0.01 < PLAN.rate(0.03)
