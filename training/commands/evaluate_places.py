"""Recall of places with a network: ``python -m training.commands.evaluate_places --network FILE --data DATA``.

A checkpoint is judged as it would be served: it is exported, opened as the encoder ``compact``, given a general
vocabulary of its own (see `training.commands.train_vocabulary`), and measured by `lab.evaluate`, which enrols and
queries through the service's own code. The sets are the folder pairs below ``DATA/places``.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from lab import evaluate
from lab.datasets import pairs
from lab.datasets.dataset import Dataset
from lab.evaluation.in_process import contender, runtime_for_measuring
from lab.evaluation.measuring import Evaluation
from lab.evaluation.progress import progress_bar
from lab.evaluation.querying import Progress
from lab.evaluation.tables import as_json, overview
from schemas.errors import RevisitError
from schemas.image import Image
from schemas.settings import Settings, read_settings
from training.commands.export import export
from training.commands.train_vocabulary import general_images, train_vocabulary
from worker.description.ports import Encoder
from worker.description.presets import PRESETS, adapted
from worker.encoders.compact.encoder import CompactEncoder

SETS = ("corridor", "essex_campus", "gardenspoint", "months", "nordland", "pepper_changed", "pepper_repeat")
"""Sets that checkpoints are judged on; the others below ``DATA/places`` are kept for final evaluations."""


def open_encoder(network: Path, data: Path, folder: Path, device: str = "cpu", threads: int = 1) -> CompactEncoder:
    """Open a network as the service would.

    Parameters
    ----------
    network : Path
        A checkpoint (``.pt``), or an exported ``.safetensors`` with its graph and JSON file beside it.
    data : Path
        Data folder with the labels and their CLIP vectors; read for a checkpoint only.
    folder : Path
        A checkpoint is exported into it.
    device : str
        ``cpu``: ONNX Runtime; ``cuda``: torch.
    threads : int
        Of ONNX Runtime.

    Raises
    ------
    SetupError
        Exported files are missing or do not belong together.
    """
    weights = export(network, data, folder) if network.suffix == ".pt" else network
    return CompactEncoder(device, weights, threads=threads)


def recall_of(
    encoder: Encoder,
    images: Iterable[Image],
    datasets: Sequence[Dataset],
    settings: Settings,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Evaluation]:
    """Measure an encoder on sets of places with the preset that the settings name.

    Parameters
    ----------
    encoder : Encoder
    images : iterable of Image
        What its general vocabulary is trained on.
    datasets : sequence of Dataset
    settings : Settings
        Where data are kept is not touched.
    seed : int
        Of the vocabulary, of the order of enrolment and of the intervals.
    progress : Progress or None

    Raises
    ------
    ValueError
        Too few images for the vocabulary of the preset.
    """
    vocabulary = train_vocabulary(encoder, adapted(settings.preset, encoder), images, seed)
    with runtime_for_measuring(settings, settings.device, lambda settings, threads: (encoder, None)) as runtime:
        judged = [contender(runtime, settings.preset, vocabulary)]
        return [
            evaluate.run(dataset, judged, seed=seed, progress=progress, examples=0).evaluation for dataset in datasets
        ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print recall@1 of each set; 0, or 2 when a file or a folder is not as it must be."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.evaluate_places", description="Recall of places with a network."
    )
    parser.add_argument("--network", type=Path, required=True, help="checkpoint.pt or an exported .safetensors")
    parser.add_argument("--data", type=Path, required=True, help="has places/, segmentation/, text/, ...")
    parser.add_argument("--pairs", nargs="+", default=SETS, help="names of sets, or parts of names")
    parser.add_argument("--preset", choices=tuple(PRESETS), default="default")
    parser.add_argument("--seed", type=int, default=0, help="of the vocabulary and of the order of enrolment")
    parser.add_argument("--device", default="cpu", help="where the network runs")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write all figures here")
    options = parser.parse_args(arguments)
    try:
        settings = read_settings(
            encoder="compact", preset=options.preset, device=options.device, threads=options.threads
        )
        found = pairs.read(options.data / "places")
        datasets = [dataset for dataset in found if any(part in dataset.name for part in options.pairs)]
        if not datasets:
            names = ", ".join(dataset.name for dataset in found)
            parser.error(f"--pairs {' '.join(options.pairs)} fits none of: {names}")
        with tempfile.TemporaryDirectory(prefix="revisit-export-") as folder:
            encoder = open_encoder(options.network, options.data, Path(folder), options.device, options.threads)
            images = general_images(options.data, options.seed)
            with progress_bar("places") as progress:
                figures = recall_of(encoder, images, datasets, settings, seed=options.seed, progress=progress)
    except RevisitError as refusal:
        print(refusal.detail, file=sys.stderr)
        return 2
    print(overview(figures))
    if options.json:
        options.json.write_text(as_json(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
