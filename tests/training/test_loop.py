import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from training.data import batches as data
from training.data.lexicon import ClipWords, Lexicon
from training.data.mix import Mix
from training.loop import Run
from training.losses.label_loss import WordLoss
from training.losses.two_channels import TwoChannelPlan, TwoChannels
from training.models.network import TrainedNetwork

MIX = Mix(strong=2, mild=2, clear=2, size=(64, 96), clear_size=(64, 96))
PLAN = TwoChannelPlan(steps=4, log_every=2, checkpoint_every=100)


def run_in(folder: Path, data_folder: Path, plan: TwoChannelPlan = PLAN) -> tuple[Run, data.Batches]:
    torch.manual_seed(0)
    folder.mkdir(exist_ok=True)
    found = data.sources(data_folder, None)
    lexicon = Lexicon(ClipWords(data_folder / data.CLIP_FILE), data.classes(data_folder))
    word_loss = WordLoss(
        torch.from_numpy(lexicon.vectors),
        torch.from_numpy(lexicon.members()),
        torch.from_numpy(lexicon.known()),
        torch.ones(len(lexicon.meanings)),
        temperature=0.07,
    )
    anchor = nn.Conv2d(3, 8, 8, stride=8).requires_grad_(False)
    network = TrainedNetwork()
    run = Run(network, TwoChannels(network, word_loss, anchor, plan), plan, folder)
    return run, data.Batches(found, lexicon, MIX, seed=5)


def values(run: Run, batch: dict[str, Tensor]) -> dict[str, float]:
    return {name: loss.item() for name, loss in run.objective(batch)[1].items()}


def stopping_after_two(run: Run, stream: Iterator[dict[str, Tensor]]) -> Iterator[dict[str, Tensor]]:
    yield next(stream)
    run.stop()
    yield next(stream)


def test_a_batch_depends_on_seed_and_step_alone(data_folder: Path, tmp_path: Path) -> None:
    _, batches = run_in(tmp_path, data_folder)

    again, other = batches[7], batches[8]

    assert all(torch.equal(tensor, again[name]) for name, tensor in batches[7].items())
    assert not torch.equal(again["pictures"], other["pictures"])


def test_the_loss_sinks_on_a_batch_seen_again_and_again(data_folder: Path, tmp_path: Path) -> None:
    run, batches = run_in(tmp_path, data_folder, dataclasses.replace(PLAN, steps=20, trunk_rate=1e-3))
    names = ("clear_word", "word", "words_two_view", "detail_two_view")
    # Not every small batch has something to teach by each loss: labels under strong light, cells in both views.
    batch = next(b for b in map(batches.__getitem__, range(50)) if min(values(run, b)[name] for name in names) > 0)
    before = values(run, batch)

    run.train(iter([batch] * 20))

    after = values(run, batch)
    for name in names:
        assert after[name] < before[name]


def test_a_resumed_run_takes_the_steps_that_the_whole_run_takes(data_folder: Path, tmp_path: Path) -> None:
    whole, batches = run_in(tmp_path / "whole", data_folder)
    whole.train(data.stream(batches, 0, workers=0))

    stopped, batches = run_in(tmp_path / "halves", data_folder)
    stopped.train(stopping_after_two(stopped, data.stream(batches, 0, workers=0)))
    assert stopped.step == 2
    resumed, batches = run_in(tmp_path / "halves", data_folder)
    resumed.resume()
    resumed.train(data.stream(batches, resumed.step, workers=0))

    assert resumed.step == whole.step == 4
    for (name, one), other in zip(
        whole.average.state_dict().items(), resumed.average.state_dict().values(), strict=True
    ):
        assert torch.allclose(one, other, atol=1e-6), name


def test_the_log_has_a_line_of_mean_losses_every_few_steps(data_folder: Path, tmp_path: Path) -> None:
    run, batches = run_in(tmp_path, data_folder)

    run.train(data.stream(batches, 0, workers=0))

    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4]
    assert {"clear_word", "word", "words_two_view", "detail_two_view", "likeness"} <= lines[0].keys()


@pytest.mark.parametrize("progress", [0.0, 0.01, 0.03, 0.5, 1.0])
def test_the_learning_rate_rises_briefly_and_sinks_to_nothing(progress: float) -> None:
    rate = PLAN.rate(progress)

    assert 0 < rate <= 1.003
    assert PLAN.rate(1.0) < 0.01 < PLAN.rate(0.03)
