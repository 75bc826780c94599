"""What words find on labelled photographs, and what a preview of dynamic labels says:
``./revisit benchmark words FOLDER...``.

The images of each folder are enrolled in a map of a service of its own, as a user does. Each class of their label maps
whose words are labels of the map is searched for, and the order of the views is held against the label maps.
"""

import argparse
import json
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lab.benchmarks.blurring import IGNORED
from lab.faults.process import Running, settings
from lab.metrics.precision_recall import precision_recall
from schemas.description import Floats

if TYPE_CHECKING:
    from revisit_client import Revisit

FIRST = 10
"""Views that somebody looks at."""

SHOWN = 0.02
"""Share of the labelled pixels from which an image shows something."""

LEAST = 5
"""Images that must show it."""


@dataclass(frozen=True)
class Outcome:
    """What the words of one class found.

    Parameters
    ----------
    words : str
    shown : float
        Share of all images that show it: what a draw would find.
    first : float
        Share of the first `FIRST` views that show it.
    precision : float
        Average precision of the order, 0..1.
    """

    words: str
    shown: float
    first: float
    precision: float


def label_shares(folder: Path) -> dict[str, Floats]:
    """Share of the labelled pixels of each label value by the image's name, float32 (256,); unlabelled images left
    out."""
    found: dict[str, Floats] = {}
    for path in sorted((folder / "images").iterdir()):
        values = cv2.imread(str(folder / "labels" / f"{path.stem}.png"), cv2.IMREAD_UNCHANGED)
        counts = np.bincount(np.asarray(values).ravel(), minlength=256).astype(np.float32)
        counts[IGNORED] = 0
        if counts.sum():
            found[path.name] = counts / counts.sum()
    return found


def searched(revisit: "Revisit", into: str, words: Sequence[str], shares: dict[str, float]) -> Outcome | None:
    """What a search finds; None where too few images show it. Images that are not found come last."""
    shown = {name for name, share in shares.items() if share >= SHOWN}
    if len(shown) < LEAST:
        return None
    text = ",".join(words)
    names = [str(view.place) for view in revisit.views(into, words=text)]
    names += sorted(set(shares) - set(names))
    flags = np.array([name in shown for name in names])
    curve = precision_recall(-np.arange(len(flags), dtype=np.float64), flags, flags)
    return Outcome(text, len(shown) / len(shares), float(flags[:FIRST].mean()), curve.average_precision)


def rows(revisit: "Revisit", folder: Path) -> Iterable[tuple[Outcome, float, float]]:
    """For each class: what its words find, what a preview says would go were they dynamic, and what they truly are,
    both as shares of the area of all images."""
    into = folder.parent.name
    images = label_shares(folder)
    for name in images:
        revisit.enroll(folder / "images" / name, map=into, place=name)
    labels = set(revisit.map(into).recipe["labels"])
    classes: dict[str, list[str]] = json.loads((folder.parent / "classes.json").read_text())
    for number, names in classes.items():
        words = [name for name in names if name in labels]
        shares = {name: float(of[int(number)]) for name, of in images.items()}
        found = searched(revisit, into, words, shares) if words else None
        if found is not None:
            yield found, revisit.preview_dynamic(into, words).after, mean(shares.values())


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table for each folder."""
    parser = argparse.ArgumentParser(prog="revisit benchmark words", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("folders", type=Path, nargs="+", help="with images/ and labels/; classes.json beside it")
    given = parser.parse_args(arguments)

    from revisit_client import Revisit

    with (
        tempfile.TemporaryDirectory() as scratch,
        Running("serve", settings(Path(scratch), {"REVISIT_ENCODER": "compact"})) as process,
    ):
        process.await_ready()
        with Revisit(process.url, timeout=120) as revisit:
            for folder in given.folders:
                table = list(rows(revisit, folder))
                if not table:
                    raise SystemExit(f"{folder}: no class is a label of the map and shown by {LEAST} images or more")
                print(f"\n{folder.parent.name}: {len(label_shares(folder))} images, {FIRST} first views\n")
                print("| words | images that show it | first views | average precision | preview | true share |")
                print("|---|---|---|---|---|---|")
                for found, preview, true in table:
                    print(
                        f"| {found.words} | {found.shown:.2f} | {found.first:.2f} | {found.precision:.2f} "
                        f"| {preview:.3f} | {true:.3f} |"
                    )
                mean_first, mean_shown = mean(f.first for f, *_ in table), mean(f.shown for f, *_ in table)
                mean_precision = mean(f.precision for f, *_ in table)
                print(f"| mean | {mean_shown:.2f} | {mean_first:.2f} | {mean_precision:.2f} | | |")


if __name__ == "__main__":
    main()
