"""Words, their CLIP vectors, and what each data set's classes mean in words."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from worker.method.unit_length import unit

Floats = npt.NDArray[np.float32]

STAND_INS: dict[str, tuple[str, ...]] = {
    "vehicle": ("car", "truck", "bus", "motorcycle"),
    "parking": ("parking space",),
    "trunk": ("branch", "wood"),
    "other": ("background",),
    "nature": ("vegetation", "tree", "plant"),
    "structure": ("building", "wall"),
    "human": ("person",),
    "bicyclist": ("cyclist",),
    "object": ("pole", "traffic sign", "fence"),
    "lane marking": ("road",),
    "television": ("tv",),
    "blinds": ("window-blind",),
    "books": ("book",),
}
"""Words without a vector of their own, and the words whose unit mean stands for each."""

STREET_WORDS = (
    "road",
    "sidewalk",
    "building",
    "wall",
    "fence",
    "pole",
    "traffic light",
    "traffic sign",
    "vegetation",
    "terrain",
    "sky",
    "person",
    "rider",
    "car",
    "truck",
    "bus",
    "train",
    "motorcycle",
    "bicycle",
)
"""The trunk's own outputs, in its order."""

INDOOR_SETS = ("nyuv2",)

ANYWHERE = frozenset(
    (
        *("wall", "window", "windowpane", "door", "person", "pedestrian", "child", "animal", "box", "bag", "light"),
        *("lamp", "picture", "poster", "painting", "paper", "clothes", "column", "railing", "fence", "signboard"),
        *("plant", "blinds", "curtain", "mirror", "ground", "path", "walkway", "bridge", "bicycle", "pole", "stones"),
    )
)
"""Words that can be met both in rooms and outdoors, so that a label of one realm says nothing about them."""

SKY = frozenset(("sky", "clouds"))

BEHIND = SKY | frozenset(
    (
        *("tree", "vegetation", "bush", "hedge", "plant", "grass", "field", "terrain", "earth", "dirt", "ground"),
        *("gravel", "road", "street", "lane marking", "sidewalk", "pavement", "parking", "path", "dirt track", "sand"),
        *("snow", "rock", "mountain", "hill", "water", "river", "lake", "sea", "waterfall", "floor", "ceiling"),
    )
)
"""Words of what lies behind: a pixel labelled so shows none of `IN_FRONT`, whether or not its set labels those."""

IN_FRONT = frozenset(
    (
        *("traffic sign", "traffic light", "signboard", "pole", "column", "fence", "railing", "person", "pedestrian"),
        *("animal", "cyclist", "rider", "motorcyclist", "bicycle", "motorcycle", "car", "van", "truck", "bus"),
        *("vehicle", "train"),
    )
)
"""Words of what stands in front."""


class ClipWords:
    """CLIP's vectors of English words, centred: raw, they lie in a cone of mean cosine 0.75.

    Parameters
    ----------
    path
        An ``.npz`` with ``words`` and ``vectors``; one CLIP model only, since two models' spaces differ.
    """

    def __init__(self, path: Path) -> None:
        with np.load(path) as arrays:
            vectors = unit(arrays["vectors"].astype(np.float32))
            self._raw = dict(zip(arrays["words"].tolist(), vectors, strict=True))
        self.centre = vectors.mean(axis=0)

    def sources(self, word: str) -> tuple[str, ...]:
        """Name the CLIP words behind `word`: itself, its stand-ins, or none when it is unknown."""
        if word in self._raw:
            return (word,)
        return STAND_INS.get(word, ())

    def vector(self, word: str) -> Floats:
        """Give the centred unit vector of a known word: float32 of shape (512,)."""
        sources = self.sources(word)
        if not sources:
            raise KeyError(word)
        mean = unit(np.mean([self._raw[source] for source in sources], axis=0))
        centred: Floats = unit(mean - self.centre)
        return centred

    def matrix(self, words: Sequence[str]) -> Floats:
        """Give the vectors of several words: float32 of shape (n_words, 512)."""
        return np.stack([self.vector(word) for word in words])


@dataclass(frozen=True)
class Meaning:
    """What one label value of one data set says: the pixel shows one of these words."""

    data_set: str
    value: int
    words: tuple[str, ...]


class Lexicon:
    """All that the training's labels can say.

    Parameters
    ----------
    clip
        Vectors of the words.
    classes
        For each data set, its label values and the words each may mean. Words that CLIP's file has no vector for
        are left out; a class of which no word is left teaches nothing.

    Attributes
    ----------
    words : list of str
        Every word that some class names, sorted.
    meanings : list of Meaning
        One per class of each set.
    """

    def __init__(self, clip: ClipWords, classes: dict[str, dict[int, Sequence[str]]]) -> None:
        self.meanings = [
            Meaning(data_set, value, known)
            for data_set, values in classes.items()
            for value, words in values.items()
            if (known := tuple(word for word in words if clip.sources(word)))
        ]
        self.words = sorted({word for meaning in self.meanings for word in meaning.words})
        self.sets = list(classes)
        self.vectors: Floats = clip.matrix(self.words)

    def members(self) -> npt.NDArray[np.bool_]:
        """Say which words each meaning allows: bool of shape (n_meanings, n_words)."""
        return np.array([[word in meaning.words for word in self.words] for meaning in self.meanings])

    def known(self) -> npt.NDArray[np.bool_]:
        """Say which words each meaning's labels speak for or against; on the others their silence teaches nothing.

        A set speaks for its own words, and a room's label speaks against a street's words (and the other way round)
        unless they can be met in both: otherwise nothing would ever tell a floor from a pavement. What lies behind
        speaks against what stands in front, and the sky against everything: otherwise nothing would ever tell a hedge
        from a cyclist in towns whose people have no labels.

        Returns
        -------
        bool of shape (n_meanings, n_words)
        """
        members = self.members()
        owners = np.array([meaning.data_set for meaning in self.meanings])
        own = np.stack([members[owners == data_set].any(axis=0) for data_set in self.sets])
        indoors = np.array([data_set in INDOOR_SETS for data_set in self.sets])
        somewhere = np.array([word not in ANYWHERE for word in self.words])
        known = own.copy()
        known[indoors] |= own[~indoors].any(axis=0) & somewhere
        known[~indoors] |= own[indoors].any(axis=0) & somewhere
        spoken: npt.NDArray[np.bool_] = known[[self.sets.index(owner) for owner in owners]]
        spoken[[BEHIND.issuperset(m.words) for m in self.meanings]] |= [word in IN_FRONT for word in self.words]
        spoken[[SKY.issuperset(m.words) for m in self.meanings]] = True
        return spoken

    def table(self, data_set: str) -> npt.NDArray[np.int16]:
        """Map a set's label values to meanings: int16 of shape (256,), -1 where a value teaches nothing."""
        table = np.full(256, -1, np.int16)
        for index, meaning in enumerate(self.meanings):
            if meaning.data_set == data_set:
                table[meaning.value] = index
        return table


def class_words(path: Path) -> dict[int, Sequence[str]]:
    """Read ``classes.json``: label value to the words it may mean, the set's own name first."""
    content = json.loads(path.read_text())
    content = content.get("classes", content)
    return {int(value): (words if isinstance(words, list) else [words]) for value, words in content.items()}
