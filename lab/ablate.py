"""What each part of the method gives: one part at a time switched, on every set.

``python -m lab.ablate pairs --root DIR --write FILE``.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

import numpy as np

from lab import evaluate
from lab.datasets.dataset import Dataset
from lab.evaluation.measuring import RUN
from lab.evaluation.querying import Progress, ask
from lab.evaluation.service import map_of_its_own
from lab.metrics.recall import Doubles, bootstrap_interval, first_right
from schemas.description import Floats, PixelField
from schemas.errors import RevisitError
from schemas.image import Image
from schemas.recipe import Channel, Graph, Parameters, Recipe
from schemas.records import Meaning
from schemas.settings import read_settings
from worker.description import vocabularies
from worker.description.describer import Describer
from worker.description.describers import Describers
from worker.description.ports import Encoder
from worker.description.presets import PRESETS, general_vocabulary, make_recipe
from worker.description.scheduler import Scheduler
from worker.loop import Loop
from worker.runtime import Runtime, build, make_product

Change = Callable[[Parameters], Parameters]


@dataclass(frozen=True)
class Variant:
    """One part of the method switched.

    Parameters
    ----------
    name : str
        In the table.
    change : function
        Of the preset's parameters.
    preset : str
    static_only : bool
        False keeps what moves.
    own_vocabulary : bool
        Whether the vocabulary is trained on the set's database pictures instead of being the general one. Where
        sizes change it must be; compare such variants with the one that changes nothing but the source.
    vocabulary : Path, optional
        A vocabulary of the preset's sizes to take instead of the one that ships: trained from another seed, say.
    """

    name: str
    change: Change
    preset: str = "default"
    static_only: bool = True
    own_vocabulary: bool = False
    vocabulary: Path | None = None


def _same(p: Parameters) -> Parameters:
    return p


def _with(**changes: object) -> Change:
    """Replace parameters."""
    return lambda p: p.model_copy(update=changes)


def _each_channel(**changes: object) -> Change:
    """Replace something of every channel."""
    return lambda p: p.model_copy(
        update={"channels": {name: c.model_copy(update=changes) for name, c in p.channels.items()}}
    )


def _without(*terms: str) -> Change:
    """Give terms of the score no weight."""
    return lambda p: p.model_copy(
        update={"weights": {t: 0.0 if t.startswith(terms) else w for t, w in p.weights.items()}}
    )


def _both(first: Change, second: Change) -> Change:
    """One change after another."""
    return lambda p: second(first(p))


def _only(channel: str) -> Change:
    """Search and rank by one channel alone."""

    def change(p: Parameters) -> Parameters:
        channels: dict[str, Channel] = {name: c for name, c in p.channels.items() if name == channel}
        weights = {t: w for t, w in p.weights.items() if "." not in t or t.endswith(f".{channel}")}
        dense = None if p.dense is None else p.dense.among(channels)
        return p.model_copy(update={"channels": channels or p.channels, "weights": weights, "dense": dense})

    return change


def _in_cells(**changed: object) -> Change:
    def change(p: Parameters) -> Parameters:
        return p.model_copy(update={"dense": p.dense and p.dense.model_copy(update=changed)})

    return change


VARIANTS = (
    Variant("default", _same),
    Variant("without dynamic filtering", _same, static_only=False),
    Variant("dynamic filtering without caution", lambda p: p.model_copy(update={"dynamic": type(p.dynamic)()})),
    Variant("hard assignment", _each_channel(assignments=1)),
    Variant("L1 instead of Hellinger", _each_channel(normalisation="l1")),
    Variant("1,000 drawn cells instead of all", _each_channel(descriptors=1000)),
    Variant("channel words alone", _only("words")),
    Variant("channel detail alone", _only("detail")),
    Variant("histograms alone", _with(candidates=0)),
    Variant("25 candidates", _with(candidates=25)),
    Variant("views at any scale", _in_cells(scale_penalty=0.0)),
    Variant("joined cells only", _in_cells(alone={})),
    Variant("re-ranking without dense cells", _without("dense", "close")),
    Variant("re-ranking without the graph", _without("graph")),
    Variant("re-ranking without verification", _both(_without("verification"), _with(verification=None))),
    Variant("the graph alone decides", _with(ranking="graph")),
    Variant("vocabulary of the set", _same, own_vocabulary=True),
    Variant("vocabulary of the set, 64 words", _each_channel(words=64, dimensions=None), own_vocabulary=True),
    Variant("vocabulary of the set, 256 words", _each_channel(words=256, dimensions=None), own_vocabulary=True),
    Variant("vocabulary of the set, without PCA", _each_channel(dimensions=None), own_vocabulary=True),
    Variant("paper", _same, preset="paper", own_vocabulary=True),
    Variant("paper, without dynamic filtering", _same, preset="paper", static_only=False, own_vocabulary=True),
    Variant("paper, histograms alone", _with(candidates=0), preset="paper", own_vocabulary=True),
    Variant("paper, 64 words", _each_channel(words=64), preset="paper", own_vocabulary=True),
    Variant(
        "paper, regions of 8 cells or more",
        lambda p: p.model_copy(update={"graph": Graph(min_region_cells=8, cosine=p.graph.cosine, tau=p.graph.tau)}),
        preset="paper",
        own_vocabulary=True,
    ),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Measured:
    """What one variant got on one set: per query, whether the first answer was right.

    Parameters
    ----------
    found : float64 of shape (answerable queries, 1)
        0 or 1.
    """

    variant: str
    dataset: str
    found: Doubles


class RememberingEncoder:
    """An encoder that encodes each picture once: variants differ in what is made of its field, not in the field.

    Parameters
    ----------
    encoder : Encoder
    """

    def __init__(self, encoder: Encoder) -> None:
        self._encoder = encoder
        self._fields: dict[str, PixelField] = {}

    @property
    def name(self) -> str:
        """Of the encoder."""
        return self._encoder.name

    @property
    def digest(self) -> str:
        """Of the encoder."""
        return self._encoder.digest

    @property
    def layers(self) -> Mapping[str, int]:
        """Of the encoder."""
        return self._encoder.layers

    def encode(self, images: Sequence[Image]) -> Iterator[PixelField]:
        """Fields, from memory where the picture was met before."""
        for image in images:
            if image.digest not in self._fields:
                [self._fields[image.digest]] = self._encoder.encode([image])
            yield self._fields[image.digest]

    def fine(self, image: Image) -> PixelField:
        """Of the encoder; nothing is measured on it, so it is not remembered."""
        return self._encoder.fine(image)

    def text_vectors(self, words: Sequence[str]) -> Floats:
        """Of the encoder."""
        return self._encoder.text_vectors(words)

    def meanings(self, words: Sequence[str]) -> list[Meaning]:
        """Of the encoder."""
        return self._encoder.meanings(words)

    def forget(self) -> None:
        """Let go of all fields: a set of 400 pictures takes some 2 GB."""
        self._fields.clear()


def remembering(runtime: Runtime) -> tuple[Runtime, RememberingEncoder]:
    """A house that has not been started, with an encoder that encodes each picture once."""
    encoder = RememberingEncoder(runtime.encoder)
    scheduler = Scheduler(encoder, 1, runtime.settings.queries)
    general = [general_vocabulary(encoder, name) for name in PRESETS]
    describers = Describers(encoder, runtime.store, general, make_product(runtime.settings))
    lease = timedelta(seconds=runtime.settings.lease_s)
    loop = Loop(runtime.store, scheduler, describers, runtime.decode, name="ablation", batch=1, lease=lease)
    return replace(runtime, encoder=encoder, scheduler=scheduler, describers=describers, loop=loop), encoder


def recipe_of(variant: Variant, runtime: Runtime, dataset: Dataset) -> Recipe:
    """The recipe of a variant; trains its vocabulary on the set's database where it has one of its own.

    Raises
    ------
    RevisitError, ValueError
        The encoder cannot carry it, or the set has too few pictures for its sizes.
    """
    plain = make_recipe(runtime.encoder, variant.preset, dynamic=None if variant.static_only else ())
    parameters = variant.change(plain.parameters)
    general = general_vocabulary(runtime.encoder, variant.preset)
    if variant.vocabulary is not None:
        other = vocabularies.Vocabulary.read(variant.vocabulary.read_bytes(), variant.vocabulary.name)
        other.check(parameters, runtime.encoder.layers)
        runtime.store.vocabularies.keep(other.digest, other.tensors)
        return plain.model_copy(update={"parameters": parameters, "vocabulary": other.digest})
    if not variant.own_vocabulary:
        general.check(parameters, runtime.encoder.layers)
        return plain.model_copy(update={"parameters": parameters})
    see = Describer(runtime.encoder, plain, general).see
    images = (runtime.decode(path.read_bytes()) for path in dataset.database)
    fields = runtime.encoder.encode(list(images))
    learned = vocabularies.train(fields, lambda field: see(field).static, parameters, parameters.seed)
    runtime.store.vocabularies.keep(learned.digest, learned.tensors)
    return plain.model_copy(update={"parameters": parameters, "vocabulary": learned.digest})


def ablate(
    datasets: Sequence[Dataset],
    variants: Sequence[Variant],
    runtime: Runtime,
    encoder: RememberingEncoder,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Measured]:
    """Measure every variant on every set; one that cannot be carried out is left out, and said on standard error."""
    measured = []
    for dataset in datasets:
        for done, variant in enumerate(variants, start=1):
            try:
                recipe = recipe_of(variant, runtime, dataset)
            except (RevisitError, ValueError) as reason:
                print(f"{dataset.name}: left out {variant.name}: {reason}", file=sys.stderr)
                continue
            with map_of_its_own(runtime, recipe, variant.name, dataset) as retriever:
                results = ask(dataset, retriever, seed=seed)
            right = first_right(results.ranked, dataset.judged())[dataset.judged().answerable] == 1
            measured.append(Measured(variant.name, dataset.name, right[:, None].astype(np.float64)))
            if progress:
                progress(f"{dataset.name}: variants", done, len(variants))
        encoder.forget()
    return measured


def as_markdown(measured: Sequence[Measured], baseline: str = "default", seed: int = 0) -> str:
    """recall@1 in percent of each variant on each set, and its difference from the baseline over all sets.

    The last column is the mean over sets of the difference, with a 95 % interval from drawing queries again in runs
    of neighbours within each set: which set was measured is not drawn, so the interval says nothing of other sets.
    """
    names = list(dict.fromkeys(m.variant for m in measured))
    sets = list(dict.fromkeys(m.dataset for m in measured))
    found = {(m.variant, m.dataset): m.found for m in measured}
    lines = [f"| variant | {' | '.join(sets)} | against {baseline} |", "|" + " --- |" * (len(sets) + 2)]
    for name in names:
        cells = [f"{100 * found[name, s].mean():.1f}" if (name, s) in found else "-" for s in sets]
        both = [s for s in sets if (name, s) in found and (baseline, s) in found]
        gain = "" if name == baseline or not both else _difference(found, name, baseline, both, seed)
        lines.append(f"| {name} | {' | '.join(cells)} | {gain} |")
    return "\n".join(lines)


def _difference(
    found: Mapping[tuple[str, str], Doubles], name: str, baseline: str, sets: Sequence[str], seed: int
) -> str:
    """Mean over sets of the paired difference in points of recall@1, with its interval."""
    differences = [found[name, s] - found[baseline, s] for s in sets]
    rng = np.random.default_rng(seed)
    halves = []
    for difference in differences:
        low, high = bootstrap_interval(difference, rng, block=RUN, resamples=500)
        halves.append((high[0] - low[0]) / 2)
    # Sets are independent of each other, so the squares of their half widths add up.
    half = float(np.sqrt(np.sum(np.square(halves)))) / len(sets)
    return f"{100 * np.mean([d.mean() for d in differences]):+.1f} ±{100 * half:.1f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="ablation", description=__doc__.splitlines()[0])
    evaluate.add_arguments(parser)
    parser.add_argument("--write", type=Path, help="Markdown file to write the table to")
    parser.add_argument("--variants", help="comma-separated names or parts of names; default: all")
    parser.add_argument(
        "--vocabulary", type=Path, action="append", default=[], help="also measure the default with this vocabulary"
    )
    options = parser.parse_args(argv)
    wanted = options.variants.split(",") if options.variants else [""]
    chosen = [v for v in VARIANTS if any(part in v.name for part in wanted)]
    chosen += [
        Variant(f"vocabulary {path.parent.name}/{path.name}", _same, vocabulary=path) for path in options.vocabulary
    ]
    try:
        datasets = evaluate.read(options.dataset, options)
        with tempfile.TemporaryDirectory() as folder:
            runtime, encoder = remembering(build(read_settings(data=Path(folder), device=options.device)))
            runtime.start()
            try:
                measured = ablate(
                    datasets, chosen, runtime, encoder, seed=options.seed, progress=evaluate.Bar("ablation")
                )
            finally:
                runtime.stop()
    except RevisitError as refusal:
        print(refusal.detail, file=sys.stderr)
        return 2
    table = as_markdown(measured, chosen[0].name, options.seed)
    print(table)
    if options.write:
        options.write.write_text(table + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
