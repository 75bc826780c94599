"""The baselines by name. NetVLAD is imported late: it brings torch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.baselines.baseline import Baseline
from lab.baselines.hog import Hog
from lab.baselines.label_shares import LabelShares
from lab.baselines.orb_words import OrbWords
from lab.baselines.random_order import RandomOrder
from lab.baselines.tiny import TinyImage
from schemas.errors import InvalidParameters
from schemas.image import Image
from worker.description.ports import Encoder

NAMES = ("random", "tiny", "hog", "orb", "labels", "netvlad")
PLAIN = ("random", "tiny", "hog", "orb")
"""Those that need nothing but the images."""


@dataclass(frozen=True)
class Needs:
    """What some baselines need besides the images."""

    encoder: Encoder | None = None
    labels: tuple[str, ...] = ()
    dynamic: tuple[str, ...] = ()
    decode: Callable[[Path], Image] | None = None
    netvlad: Path | None = None
    device: str = "cpu"


def baselines(names: Sequence[str], needs: Needs, seed: int = 0) -> list[Baseline]:
    """Baselines by name.

    Raises
    ------
    InvalidParameters
        For an unknown name, or one that needs what is not given.
    """
    return [_make(name, needs, seed) for name in names]


def _make(name: str, needs: Needs, seed: int) -> Baseline:
    if name == "random":
        return RandomOrder(seed)
    if name == "tiny":
        return TinyImage()
    if name == "hog":
        return Hog()
    if name == "orb":
        return OrbWords(seed=seed)
    if name == "labels":
        if needs.encoder is None or needs.decode is None:
            raise InvalidParameters.of("baselines", "labels needs the encoder of a service in this process")
        return LabelShares(needs.encoder, needs.labels, needs.dynamic, needs.decode)
    if name == "netvlad":
        if needs.netvlad is None:
            raise InvalidParameters.of("baselines", "netvlad needs its published weights: --netvlad FILE")
        from lab.baselines.netvlad import NetVladBaseline

        return NetVladBaseline(needs.netvlad, needs.device)
    raise InvalidParameters.of("baselines", f"{name!r} is not known; there are {', '.join(NAMES)}")
