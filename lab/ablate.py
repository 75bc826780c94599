"""What each part of the method gives: one part at a time switched, on every set.

``python -m lab.ablate pairs --root DIR --write FILE``.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.datasets.choosing import add_dataset_arguments, add_device, read
from lab.datasets.dataset import Dataset
from lab.evaluation.in_process import runtime_for_measuring, train_vocabulary
from lab.evaluation.measuring import RUN
from lab.evaluation.progress import progress_bar
from lab.evaluation.querying import Progress, query_all
from lab.evaluation.service import map_of_its_own
from lab.metrics.recall import bootstrap_interval, first_right
from schemas.description import DETAIL, SEMANTIC, Doubles, Floats, PixelField
from schemas.errors import RevisitError
from schemas.image import Image
from schemas.recipe import DynamicFilter, GraphNodes, MapRecipe
from schemas.records import Meaning
from schemas.settings import Settings, read_settings
from worker.description.ports import Encoder
from worker.description.presets import Wanted, make_recipe
from worker.description.vocabularies import Vocabulary
from worker.encoders.choosing import make_encoder
from worker.runtime import Runtime

Change = Callable[[MapRecipe], MapRecipe]


@dataclass(frozen=True)
class Variant:
    """One part of the method switched.

    Parameters
    ----------
    name : str
        In the table.
    change : function
        Of the preset's recipe.
    preset : str
    own_vocabulary : bool
        Whether the vocabulary is trained on the set's database images instead of being the general one. Where
        sizes change it must be; compare such variants with the one that changes nothing but the source.
    vocabulary : Path, optional
        A vocabulary of the preset's sizes to take instead of the one that ships: trained from another seed, say.
    """

    name: str
    change: Change
    preset: str = "default"
    own_vocabulary: bool = False
    vocabulary: Path | None = None


def _same(recipe: MapRecipe) -> MapRecipe:
    return recipe


def _described(**changes: object) -> Change:
    """Replace parameters of the description."""

    def change(recipe: MapRecipe) -> MapRecipe:
        parameters = recipe.description.parameters.model_copy(update=changes)
        description = recipe.description.model_copy(update={"parameters": parameters})
        return recipe.model_copy(update={"description": description})

    return change


def _ranked(**changes: object) -> Change:
    """Replace numbers of the ranking."""
    return lambda recipe: recipe.model_copy(update={"ranking": recipe.ranking.model_copy(update=changes)})


def _each_channel(**changes: object) -> Change:
    """Replace something of every channel."""

    def change(recipe: MapRecipe) -> MapRecipe:
        channels = recipe.description.parameters.channels
        return _described(channels={name: c.model_copy(update=changes) for name, c in channels.items()})(recipe)

    return change


def _weighed(**weights: object) -> Change:
    """Replace weights of terms of the score."""
    return lambda recipe: _ranked(weights=recipe.ranking.weights.model_copy(update=weights))(recipe)


def _only(channel: str) -> Change:
    """Search and rank by one channel."""

    def change(recipe: MapRecipe) -> MapRecipe:
        parameters, weights = recipe.description.parameters, recipe.ranking.weights
        dense = parameters.dense
        if dense is not None:
            kept = {name: w for name, w in dense.channel_weights.items() if name == channel}
            dense = dense.model_copy(update={"channel_weights": kept})
        channels = {name: c for name, c in parameters.channels.items() if name == channel}
        histogram = {name: w for name, w in weights.histogram.items() if name == channel}
        return _weighed(histogram=histogram)(_described(channels=channels, dense=dense)(recipe))

    return change


def _all_static(recipe: MapRecipe) -> MapRecipe:
    """Keep what moves."""
    return recipe.model_copy(update={"description": recipe.description.model_copy(update={"dynamic": ()})})


def _unverified(recipe: MapRecipe) -> MapRecipe:
    """Leave geometric verification out."""
    return _weighed(verification=0.0)(_ranked(verified_top_k=0)(_described(local_features=None)(recipe)))


VARIANTS = (
    Variant("default", _same),
    Variant("without dynamic filtering", _all_static),
    Variant("dynamic filtering without caution", _described(dynamic=DynamicFilter())),
    Variant("hard assignment", _each_channel(assignments=1)),
    Variant("L1 instead of Hellinger", _each_channel(normalisation="l1")),
    Variant("1,000 drawn cells instead of all", _each_channel(descriptors=1000)),
    Variant("channel semantic alone", _only(SEMANTIC)),
    Variant("channel detail alone", _only(DETAIL)),
    Variant("histograms alone", _ranked(candidates=0)),
    Variant("25 candidates", _ranked(candidates=25)),
    Variant("views at any scale", _ranked(scale_penalty=0.0)),
    Variant("joined cells only", _ranked(detail_only_top_k=0)),
    Variant("re-ranking without dense cells", _weighed(dense=0.0, dense_full=0.0)),
    Variant("re-ranking without the graph", _weighed(graph=0.0)),
    Variant("re-ranking without verification", _unverified),
    Variant("the graph alone decides", _ranked(mode="graph")),
    Variant("vocabulary of the set", _same, own_vocabulary=True),
    Variant("vocabulary of the set, 64 words", _each_channel(vocabulary_size=64, dimensions=None), own_vocabulary=True),
    Variant(
        "vocabulary of the set, 256 words", _each_channel(vocabulary_size=256, dimensions=None), own_vocabulary=True
    ),
    Variant("vocabulary of the set, without PCA", _each_channel(dimensions=None), own_vocabulary=True),
    Variant("paper", _same, preset="paper", own_vocabulary=True),
    Variant("paper, without dynamic filtering", _all_static, preset="paper", own_vocabulary=True),
    Variant("paper, histograms alone", _ranked(candidates=0), preset="paper", own_vocabulary=True),
    Variant("paper, 64 words", _each_channel(vocabulary_size=64), preset="paper", own_vocabulary=True),
    Variant(
        "paper, regions of 8 cells or more",
        _described(graph=GraphNodes(min_region_cells=8)),
        preset="paper",
        own_vocabulary=True,
    ),
)


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
    """An encoder that encodes each image once: variants differ in what is made of its field, not in the field.

    A set of 400 images takes some 2 GB.

    Parameters
    ----------
    encoder : Encoder
    """

    def __init__(self, encoder: Encoder) -> None:
        self._encoder = encoder
        self._fields: dict[str, PixelField] = {}
        self.name, self.digest, self.terms = encoder.name, encoder.digest, encoder.terms
        self.layers, self.known_labels = encoder.layers, encoder.known_labels

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """Fields, from memory where the image was met before."""
        for image in images:
            if image.digest not in self._fields:
                [self._fields[image.digest]] = self._encoder.encode([image])
            yield self._fields[image.digest]

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        """Of the encoder."""
        return self._encoder.text_vectors(labels)

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        """Of the encoder."""
        return self._encoder.meanings(labels)


def remembering(settings: Settings, threads: int) -> tuple[RememberingEncoder, None]:
    """The encoder that the settings name, each image encoded once; no segmenter, since nothing is drawn."""
    encoder, _ = make_encoder(settings, threads)
    return RememberingEncoder(encoder), None


def recipe_of(variant: Variant, runtime: Runtime, dataset: Dataset) -> MapRecipe:
    """The recipe of a variant; trains its vocabulary on the set's database where it has one of its own.

    Raises
    ------
    RevisitError, ValueError
        The encoder cannot carry it, or the set has too few images for its sizes.
    """
    plain = make_recipe(runtime.encoder, Wanted(), preset=variant.preset)
    changed = variant.change(plain)
    description = changed.description
    learned = None
    if variant.vocabulary is not None:
        learned = Vocabulary.read(variant.vocabulary.read_bytes(), variant.vocabulary.name)
        runtime.store.vocabularies.keep(learned.digest, learned.tensors)
    elif variant.own_vocabulary:
        general = plain.description.model_copy(update={"dynamic": description.dynamic})
        learned = train_vocabulary(runtime, dataset.database, runtime.describers.of(general), description.parameters)
    if learned is not None:
        description = description.model_copy(update={"vocabulary": learned.digest})
    runtime.describers.of(description)  # refuses a vocabulary of other sizes
    return changed.model_copy(update={"description": description})


def ablate(
    dataset: Dataset,
    variants: Sequence[Variant],
    runtime: Runtime,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Measured]:
    """Measure every variant on a set; one that cannot be carried out is left out, and said on standard error.

    Parameters
    ----------
    dataset : Dataset
    variants : sequence of Variant
    runtime : Runtime
        Started; an encoder that remembers (`remembering`) saves most of the time.
    seed : int
        Of the order of enrolment.
    progress : Progress, optional
    """
    measured = []
    truth = dataset.judged()
    for done, variant in enumerate(variants, start=1):
        try:
            recipe = recipe_of(variant, runtime, dataset)
        except (RevisitError, ValueError) as reason:
            print(f"{dataset.name}: left out {variant.name}: {reason}", file=sys.stderr)
            continue
        with map_of_its_own(runtime, recipe, variant.name, dataset) as retriever:
            answers = query_all(dataset, retriever, seed=seed)
        right = first_right(answers.ranked, truth)[truth.answerable] == 1
        measured.append(Measured(variant.name, dataset.name, right[:, None].astype(np.float64)))
        if progress:
            progress("variants", done, len(variants))
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
    parser = argparse.ArgumentParser(prog="python -m lab.ablate", description=__doc__.splitlines()[0])
    add_dataset_arguments(parser)
    add_device(parser)
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
    if not chosen:
        parser.error(f"--variants {options.variants} names none of: {', '.join(v.name for v in VARIANTS)}")
    if options.write:
        options.write.parent.mkdir(parents=True, exist_ok=True)
    measured: list[Measured] = []
    try:
        for dataset in read(options.dataset, options):
            # One after the other: what an encoder remembers of a set goes with it.
            with (
                runtime_for_measuring(read_settings(), options.device, remembering) as runtime,
                progress_bar(dataset.name) as bar,
            ):
                measured += ablate(dataset, chosen, runtime, seed=options.seed, progress=bar)
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
