"""Images for the demo: drawn places, or the user's own photos, and queries whose answers are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL import Image as PilImage

    from scenes import Scene

PLACES = (
    "market street", "mill lane", "station road", "church street", "harbour road", "bakers row", "school lane",
    "rose garden", "castle park", "river meadow", "east corridor", "west corridor",
)  # fmt: skip
UNKNOWN_PLACES = ("foreign street", "unknown park")
"""Unknown places: queried, but never enrolled."""


@dataclass(frozen=True)
class Enrolment:
    """An image to enrol, and the place it shows."""

    path: Path
    place: str


@dataclass(frozen=True)
class QueryRecord:
    """A query image.

    Parameters
    ----------
    place : str or None
        The right answer; None when the place was never enrolled, or is not known.
    change : str
        How the image differs from the enrolled ones.
    known : bool
        Whether the right answer is known; otherwise the answer is only shown.
    """

    path: Path
    place: str | None
    change: str
    known: bool = True


@dataclass(frozen=True)
class Material:
    """Images to enrol, and queries."""

    enrolments: Sequence[Enrolment]
    queries: Sequence[QueryRecord]


Step = Callable[[str], None]


def drawn(folder: Path, step: Step) -> Material:
    """Draw every place as enrolled (from two positions) and as queried (moved, other light, occluded) into `folder`."""
    from scenes import scene

    enrolments, queries = [], []
    for i, name in enumerate(PLACES):
        place = scene(name)
        for number, enrolled in enumerate(
            (place, place.at("overcast").seen_from(dx=-0.6, ahead=1.5, turn=-4)), start=1
        ):
            enrolments.append(Enrolment(_saved(enrolled, folder / "enrolled" / f"{_file(name)}-{number}.jpg"), name))
        change, changed = _change(i, place)
        queries.append(QueryRecord(_saved(changed, folder / "queries" / f"{_file(name)}.jpg"), name, change))
        step(name)
    for name in UNKNOWN_PLACES:
        path = _saved(scene(name), folder / "queries" / f"{_file(name)}.jpg")
        queries.append(QueryRecord(path, None, "never enrolled"))
        step(name)
    return Material(enrolments, queries)


def _change(number: int, place: "Scene") -> "tuple[str, Scene]":
    """(Description of the change, changed scene) of a query; six kinds of change in turn."""
    thing = "person" if place.kind == "corridor" else ("bus", "car")[number // 6 % 2]  # no vehicles indoors
    ways = (
        ("1 m aside, turned, dusk", place.seen_from(dx=1.0, turn=6).at("dusk")),
        (f"a {thing} in front", place.seen_from(dx=0.4, turn=-3).behind(thing)),
        ("2 m ahead, dull, a person", place.seen_from(ahead=2.0, turn=3).at("overcast").behind("person")),
        ("turned 9 degrees", place.seen_from(dx=-0.7, turn=9)),
        (f"dusk, a {thing} in front", place.seen_from(dx=0.6).at("dusk").behind(thing)),
        ("night", place.seen_from(dx=0.3, turn=2).at("night")),
    )
    return ways[number % len(ways)]


def _file(name: str) -> str:
    return name.replace(" ", "-")


def _saved(scene: "Scene", path: Path) -> Path:
    from PIL import Image as PilImage

    path.parent.mkdir(parents=True, exist_ok=True)
    PilImage.fromarray(scene.pixels).save(path, quality=92)
    return path


def of_folder(photos: Sequence[Path], folder: Path, step: Step) -> Material:
    """The user's photos: nearly all are enrolled, each as a place of its own.

    Queries are altered copies (cropped, turned, darker) of some of them, whose answers are known, and photos that are
    not enrolled, whose answers only the user can judge. A photo that cannot be read has no copy.
    """
    from schemas.errors import RevisitError

    held_back = photos[4::8][:4] if len(photos) >= 6 else []
    enrolments = [Enrolment(path, path.stem) for path in photos if path not in held_back]
    queries = []
    stride = max(1, len(enrolments) // 12)
    for i, enrolment in enumerate(enrolments[::stride][:12]):
        change, how = _ALTERATIONS[i % len(_ALTERATIONS)]
        target = folder / "queries" / f"{i:02d}-{enrolment.path.stem}.jpg"
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            upright = _opened(enrolment.path)
        except RevisitError:  # the service says why, when it is enrolled
            continue
        how(upright).save(target, quality=88)
        queries.append(QueryRecord(target, enrolment.place, change))
        step(enrolment.place)
    queries += [QueryRecord(path, None, "held back: judge yourself", known=False) for path in held_back]
    return Material(enrolments, queries)


def _opened(path: Path) -> "PilImage.Image":
    """A photo as the service reads it; raises RevisitError for one that it would refuse."""
    from PIL import Image as PilImage

    from worker.images import codec

    upright = PilImage.fromarray(codec.decode(path.read_bytes(), codec.Limits()).pixels)
    upright.thumbnail((1280, 1280))
    return upright


def _cropped(pil_image: "PilImage.Image", share: float, across: float, down: float) -> "PilImage.Image":
    """Crop to `share` of each side; `across` and `down` place the crop, 0 (left, top) to 1."""
    width, height = round(pil_image.width * share), round(pil_image.height * share)
    left, top = round((pil_image.width - width) * across), round((pil_image.height - height) * down)
    return pil_image.crop((left, top, left + width, top + height))


def _darker(pil_image: "PilImage.Image", factor: float) -> "PilImage.Image":
    from PIL import ImageEnhance

    return ImageEnhance.Brightness(pil_image).enhance(factor)


def _turned(pil_image: "PilImage.Image", degrees: float) -> "PilImage.Image":
    """Turn, then crop the empty corners."""
    from PIL.Image import Resampling

    return _cropped(pil_image.rotate(degrees, resample=Resampling.BILINEAR), 0.85, 0.5, 0.5)


_ALTERATIONS: "Sequence[tuple[str, Callable[[PilImage.Image], PilImage.Image]]]" = (
    ("cropped to 80 %, left", lambda i: _cropped(i, 0.8, 0.0, 0.5)),
    ("cropped to 75 %, right, darker", lambda i: _darker(_cropped(i, 0.75, 1.0, 0.4), 0.55)),
    ("turned 4 degrees", lambda i: _turned(i, 4)),
    ("half as bright", lambda i: _darker(i, 0.5)),
)
