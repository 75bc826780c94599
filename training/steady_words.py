"""Make the words steadier: ``python -m training.steady_words --weights FILE --data DATA --out runs/NAME``.

The deep layers of an exported network's words field are trained on for finding cells again under other light, weather
and season, more than for naming them: since fine words say what a picture shows, this field's task is to stay the same.
The shallow layers, the detail channel and the words head stay as they are, so that detail and fine words stay valid.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from training import data
from training.command import add_run_options, begin, check_run_options, prepare, run_numbers
from training.depthwise import quicken
from training.export import basis_of, network_of, shared_digest
from training.lexicon import ClipWords, Lexicon
from training.loop import Plan, Run
from training.mix import Mix
from training.two_channels import words_found_again
from training.word_loss import WordLoss, word_loss_of
from worker.encoders.compact_network import CompactNetwork

TRAINED = ("stride16.", "deep.", "context.", "from16.", "from8.", "from4.", "fuse.")
"""How the names of the parameters that change begin."""


@dataclass(frozen=True)
class SteadyPlan(Plan):
    """The numbers of a run that makes words steadier.

    Attributes
    ----------
    shared
        `training.export.shared_digest` of the weights that it began with.
    word
        Weight of the word loss beside the loss of two views.
    """

    shared: str = ""
    word: float = 0.5
    temperature: float = 0.1


class SteadyWords(nn.Module):
    """The losses of the words field on the pairs of `training.data.Batches`."""

    def __init__(self, network: CompactNetwork, word_loss: WordLoss, plan: SteadyPlan) -> None:
        super().__init__()
        self.network, self.word_loss, self.plan = network, word_loss, plan

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of the losses; and each of them, and the share of cells found again."""
        pictures = batch["pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(pictures.device.type, torch.bfloat16, enabled=self.plan.half):
            with torch.no_grad():
                shallow = self.network.shallow(pictures)
            joined = self.network.fused(*shallow)
        joined, head = joined.float(), self.network.words
        found_again, found = words_found_again(joined, head, batch, self.plan.temperature)
        word = self.word_loss(joined, head, batch["meanings"], batch["sets"])
        return found_again + self.plan.word * word, {"word": word, "two_view": found_again, "found": found}


def started_from(weights: Path) -> CompactNetwork:
    """Load an exported network, to train what lies between its shallow layers and its words head."""
    network = network_of(weights).train()
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(TRAINED))
    return network


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or go on training, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)
    found = data.sources(options.data, None)
    lexicon = Lexicon(ClipWords(options.data / data.CLIP_FILE), data.classes(options.data))

    network = started_from(options.weights)
    if options.device == "cpu":
        quicken(network)
    word_loss = word_loss_of(found, lexicon, torch.from_numpy(lexicon.vectors) @ basis_of(options.weights))
    plan = SteadyPlan(**run_numbers(options), shared=shared_digest(load_file(options.weights)), word=options.word)
    run = Run(network, SteadyWords(network, word_loss, plan), plan, options.out, device=options.device)
    begin(run, options)
    mix = Mix(strong=options.pairs, mild=0, clear=0)
    run.train(data.stream(data.Batches(found, lexicon, mix, options.seed), run.step, options.loaders))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m training.steady_words", description="Make the words steadier.")
    add_run_options(parser)
    parser.add_argument("--weights", type=Path, required=True, help="exported network to start from")
    parser.add_argument("--pairs", type=int, default=8, help="pairs of views a step")
    parser.add_argument("--word", type=float, default=SteadyPlan.word, help="weight of the word loss")
    options = parser.parse_args(arguments)
    check_run_options(parser, options)
    return options


if __name__ == "__main__":
    main()
