"""Text labels: their CLIP vectors, and which of them each data set's classes stand for."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from schemas.description import Floats
from worker.method.unit_length import unit

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
"""Labels without a CLIP vector of their own; each is represented by the unit mean of the vectors of others."""

CITYSCAPES_LABELS = (
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
"""The 19 outputs of the pretrained trunk, in its order."""

INDOOR_SETS = ("nyuv2",)
"""Data sets of rooms; all others show what is outdoors."""

INDOORS_AND_OUTDOORS = frozenset(
    (
        *("wall", "window", "windowpane", "door", "person", "pedestrian", "child", "animal", "box", "bag", "light"),
        *("lamp", "picture", "poster", "painting", "paper", "clothes", "column", "railing", "fence", "signboard"),
        *("plant", "blinds", "curtain", "mirror", "ground", "path", "walkway", "bridge", "bicycle", "pole", "stones"),
    )
)
"""Labels of what is found both indoors and outdoors: a class of an indoor set is no evidence against them, nor the
other way round."""

SKY = frozenset(("sky", "clouds"))

BACKGROUND = SKY | frozenset(
    (
        *("tree", "vegetation", "bush", "hedge", "plant", "grass", "field", "terrain", "earth", "dirt", "ground"),
        *("gravel", "road", "street", "lane marking", "sidewalk", "pavement", "parking", "path", "dirt track", "sand"),
        *("snow", "rock", "mountain", "hill", "water", "river", "lake", "sea", "waterfall", "floor", "ceiling"),
    )
)
"""Labels of surfaces that objects stand before: a pixel annotated so shows none of `FOREGROUND`, even in a data set
that has no classes for those."""

FOREGROUND = frozenset(
    (
        *("traffic sign", "traffic light", "signboard", "pole", "column", "fence", "railing", "person", "pedestrian"),
        *("animal", "cyclist", "rider", "motorcyclist", "bicycle", "motorcycle", "car", "van", "truck", "bus"),
        *("vehicle", "train"),
    )
)
"""Labels of objects that stand before the background."""


class ClipVectors:
    """CLIP text vectors of English labels, centred: raw vectors lie in a narrow cone, of mean cosine 0.75.

    Parameters
    ----------
    path : Path
        An ``.npz`` with ``words`` (n,) and ``vectors`` (n, 512), of one CLIP model.

    Attributes
    ----------
    center : float32 of shape (512,)
        Mean of the unit vectors in the file.
    """

    def __init__(self, path: Path) -> None:
        with np.load(path) as arrays:
            vectors = unit(arrays["vectors"].astype(np.float32))
            self._raw = dict(zip(arrays["words"].tolist(), vectors, strict=True))
        self.center = vectors.mean(axis=0)

    def sources(self, label: str) -> tuple[str, ...]:
        """Name the entries of the file that a label's vector is made of: itself or its stand-ins; none if unknown."""
        if label in self._raw:
            return (label,)
        return STAND_INS.get(label, ())

    def vector(self, label: str) -> Floats:
        """Give the centred vector of a label: float32 of shape (512,), unit length; raises KeyError if unknown."""
        sources = self.sources(label)
        if not sources:
            raise KeyError(label)
        mean = unit(np.mean([self._raw[source] for source in sources], axis=0))
        centred: Floats = unit(mean - self.center)
        return centred

    def matrix(self, labels: Sequence[str]) -> Floats:
        """Give the vectors of several labels: float32 of shape (n_labels, 512); raises as `vector`."""
        return np.stack([self.vector(label) for label in labels])


@dataclass(frozen=True)
class DatasetClass:
    """A class of a data set: its value in label maps, and the text labels of which its pixels show one."""

    data_set: str
    value: int
    labels: tuple[str, ...]


class Lexicon:
    """All classes that training can learn from, and all text labels that they name.

    Parameters
    ----------
    clip : ClipVectors
    classes : dict
        For each data set, label value to the text labels that the class may stand for. Labels without a CLIP vector
        are left out, and so are classes that have no other.

    Attributes
    ----------
    classes : list of DatasetClass
        The index into this list is what `training.data.batches` calls a class.
    labels : list of str
        Every text label that some class names, sorted.
    sets : list of str
        Names of the data sets.
    vectors : float32 of shape (n_labels, 512)
        CLIP vectors of `labels`.
    """

    def __init__(self, clip: ClipVectors, classes: dict[str, dict[int, Sequence[str]]]) -> None:
        self.classes = [
            DatasetClass(data_set, value, known)
            for data_set, values in classes.items()
            for value, labels in values.items()
            if (known := tuple(label for label in labels if clip.sources(label)))
        ]
        self.labels = sorted({label for each in self.classes for label in each.labels})
        self.sets = list(classes)
        self.vectors: Floats = clip.matrix(self.labels)

    def allowed(self) -> npt.NDArray[np.bool_]:
        """Say which labels each class may stand for: bool of shape (n_classes, n_labels)."""
        return np.array([[label in each.labels for label in self.labels] for each in self.classes])

    def competing(self) -> npt.NDArray[np.bool_]:
        """Say which labels a pixel of each class is compared with: its own, and those that it is evidence against.

        A class competes with the labels of its own data set. An outdoor class also competes with labels found indoors
        only, and the other way round; a class of the background competes with all foreground labels, and the sky with
        every label. Labels outside these are left out of the loss: that a data set has no class for them is no
        evidence that they are absent.

        Returns
        -------
        bool of shape (n_classes, n_labels)
        """
        allowed = self.allowed()
        owners = np.array([each.data_set for each in self.classes])
        own = np.stack([allowed[owners == data_set].any(axis=0) for data_set in self.sets])
        indoor = np.array([data_set in INDOOR_SETS for data_set in self.sets])
        exclusive = np.array([label not in INDOORS_AND_OUTDOORS for label in self.labels])
        of_set = own.copy()
        of_set[indoor] |= own[~indoor].any(axis=0) & exclusive
        of_set[~indoor] |= own[indoor].any(axis=0) & exclusive
        competing: npt.NDArray[np.bool_] = of_set[[self.sets.index(owner) for owner in owners]]
        foreground = [label in FOREGROUND for label in self.labels]
        competing[[BACKGROUND.issuperset(each.labels) for each in self.classes]] |= foreground
        competing[[SKY.issuperset(each.labels) for each in self.classes]] = True
        return competing

    def table(self, data_set: str) -> npt.NDArray[np.int16]:
        """Map a set's label values to classes: int16 of shape (256,), -1 for values that nothing is learned from."""
        table = np.full(256, -1, np.int16)
        for index, each in enumerate(self.classes):
            if each.data_set == data_set:
                table[each.value] = index
        return table


def read_classes(path: Path) -> dict[int, Sequence[str]]:
    """Read ``classes.json``: label value to the text labels the class may stand for, the set's own name first."""
    content = json.loads(path.read_text())
    content = content.get("classes", content)
    return {int(value): (labels if isinstance(labels, list) else [labels]) for value, labels in content.items()}
