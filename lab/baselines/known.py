"""The baselines by name. Those that bring networks or packages of others are imported late."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.baselines.baseline import Baseline
from lab.baselines.hog import Hog
from lab.baselines.label_shares import LabelShares
from lab.baselines.orb_words import OrbWords
from lab.baselines.random_order import RandomOrder
from lab.baselines.rootsift_vlad import FIRST, RootSift, RootSiftVlad
from lab.baselines.seqslam import SeqSlam
from lab.baselines.tiny import TinyImage
from lab.evaluation.reranking import Reranking
from schemas.errors import InvalidParameters
from schemas.image import Image
from worker.description.ports import Encoder

NAMES = (
    *("random", "tiny", "hog", "orb", "labels", "netvlad"),
    *("rootsift", "anyloc", "colmap", "seqslam", "seqslam-plain"),
)

PLAIN = ("random", "tiny", "hog", "orb")
"""Those that need nothing but the images, and no time."""


@dataclass(frozen=True)
class Needs:
    """What some baselines need besides the images."""

    encoder: Encoder | None = None
    labels: tuple[str, ...] = ()
    dynamic: tuple[str, ...] = ()
    decode: Callable[[Path], Image] | None = None
    netvlad: Path | None = None
    dinov2: Path | None = None
    dinov2_block: int | None = None
    device: str = "cpu"


@dataclass(frozen=True)
class Rivals:
    """Baselines, and what orders first answers anew."""

    baselines: tuple[Baseline, ...] = ()
    rerankings: tuple[Reranking, ...] = ()


def rivals(names: Sequence[str], needs: Needs, seed: int = 0) -> Rivals:
    """Baselines by name; ``rootsift`` brings what orders its first answers by geometry.

    Raises
    ------
    InvalidParameters
        For an unknown name, or one that needs what is not given.
    SetupError
        Weights or a package are missing.
    """
    features = RootSift()
    made = tuple(_make(name, needs, seed, features) for name in names)
    verified = tuple(Reranking(features, one.name, FIRST) for one in made if isinstance(one, RootSiftVlad))
    return Rivals(made, verified)


def _make(name: str, needs: Needs, seed: int, features: RootSift) -> Baseline:
    if name == "random":
        return RandomOrder(seed)
    if name == "tiny":
        return TinyImage()
    if name == "hog":
        return Hog()
    if name == "orb":
        return OrbWords(seed=seed)
    if name == "rootsift":
        return RootSiftVlad(features, seed=seed)
    if name == "seqslam":
        return SeqSlam()
    if name == "seqslam-plain":
        return SeqSlam(local_contrast=False)
    if name == "labels":
        if needs.encoder is None or needs.decode is None:
            raise InvalidParameters.of("baselines", "labels needs the encoder of a service in this process")
        return LabelShares(needs.encoder, needs.labels, needs.dynamic, needs.decode)
    if name == "netvlad":
        if needs.netvlad is None:
            raise InvalidParameters.of("baselines", "netvlad needs its published weights: --netvlad FILE")
        from lab.baselines.netvlad import NetVladBaseline

        return NetVladBaseline(needs.netvlad, needs.device)
    if name == "anyloc":
        if needs.dinov2 is None:
            raise InvalidParameters.of("baselines", "anyloc needs an ONNX file of DINOv2 ViT-S/14: --dinov2 FILE")
        from lab.baselines.anyloc import BLOCK, AnyLoc

        return AnyLoc(needs.dinov2, BLOCK if needs.dinov2_block is None else needs.dinov2_block, seed=seed)
    if name == "colmap":
        from lab.baselines.colmap_tree import ColmapTree

        return ColmapTree(features)
    raise InvalidParameters.of("baselines", f"{name!r} is not known; there are {', '.join(NAMES)}")
