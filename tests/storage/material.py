"""Images, recipes and descriptions to try a store with, and the simplest index that follows one."""

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np

from schemas.description import Appearance, ContextGraph, Description, Floats, Int8s, LocalFeatures
from schemas.enrolment import EnrolmentOptions
from schemas.errors import LeaseLost
from schemas.image import ImageFacts
from schemas.recipe import Channel, DescriptionParameters, DescriptionRecipe, MapRecipe, RankingConfig
from schemas.records import Claim, Submitted, ViewAttributes, ViewRecord, WorkerRecord
from worker.storage.store import SqlStore

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
NO_ATTRIBUTES = ViewAttributes()


def recipe(preset: str = "default") -> MapRecipe:
    """A recipe of two channels; another preset makes another recipe."""
    channels = {name: Channel(layer=name, vocabulary_size=4) for name in ("semantic", "detail")}
    seed = int(hashlib.sha256(preset.encode()).hexdigest()[:6], 16)
    description = DescriptionRecipe(
        encoder="color",
        weights="0" * 64,
        labels=("wall", "car"),
        dynamic=("car",),
        parameters=DescriptionParameters(channels=channels, seed=seed, local_features=300),
        vocabulary="0" * 64,
    )
    return MapRecipe(description=description, ranking=RankingConfig(preset=preset))


RECIPE = recipe()


def image(name: str) -> bytes:
    """Bytes that stand for an image; a store does not look into them."""
    return f"picture {name}".encode()


def facts(image: bytes) -> ImageFacts:
    """What a codec would find out."""
    return ImageFacts(640, 480, len(image), "png", hashlib.sha256(image).hexdigest())


def description(seed: int) -> Description:
    """A description full of numbers drawn from a seed."""
    draw = np.random.default_rng(seed)

    def floats(*shape: int) -> Floats:
        return draw.random(shape, np.float32)

    def small(*shape: int) -> Int8s:
        return draw.integers(-9, 9, shape, np.int8)

    graph = ContextGraph(np.array([0, 1], np.int16), floats(2, 2), floats(2, 3), floats(2))
    return Description(
        vectors={"semantic": floats(4), "detail": floats(4)},
        appearance=Appearance(small(1, 2, 4), graph, (1.0, 0.75)),
        cells=small(3, 5, 4),
        keypoints=LocalFeatures(floats(6, 2), small(6, 8)),
        label_shares=np.array([0.75, 0.25], np.float32),
        static_share=0.75,
        descriptor_count=120,
    )


def vector(view: ViewRecord, recipe_id: str) -> list[float]:
    """The vector that `describe` gives a view under a recipe."""
    made = description(seed(view, recipe_id)).vectors
    return [float(value) for value in np.concatenate([made["semantic"], made["detail"]])]


def seed(view: ViewRecord, recipe_id: str) -> int:
    """Of the description of a view: the same image and recipe give the same description."""
    return int(view.image.sha256[:6] + recipe_id[:6], 16)


def enroll(
    store: SqlStore,
    name: str,
    *,
    map: str = "campus",
    attributes: ViewAttributes = NO_ATTRIBUTES,
    now: datetime = NOW,
    by: MapRecipe = RECIPE,
) -> Submitted:
    """Enrol the image of that name."""
    body = image(name)
    return store.enrolment.submit(map, body, facts(body), attributes, EnrolmentOptions(now, by))


def finish(store: SqlStore, claim: Claim, now: datetime = NOW) -> int:
    """Describe what was claimed."""
    return store.jobs.finish(claim, description(seed(claim.view, claim.recipe.id)), now)


def give_sign(store: SqlStore, name: str) -> None:
    """A sign of life of a worker on another machine."""
    store.workers.beat(WorkerRecord(name, "worker", "another machine/pid:[1]", 1, 0), NOW)


def describe_all(store: SqlStore, now: datetime = NOW) -> int:
    """Work until nothing waits; returns how many descriptions that took."""
    done = 0
    while claims := store.jobs.claim("worker", 10):
        for claim in claims:
            with suppress(LeaseLost):  # its view may be deleted meanwhile
                finish(store, claim, now)
                done += 1
    return done


class Follower:
    """An index reduced to a dict: it knows of a map what `Descriptions.since` told it, and nothing else."""

    def __init__(self, store: SqlStore, name: str = "campus") -> None:
        self.store = store
        self._name = name
        self.revision = 0
        self.recipe = ""
        self.vectors: dict[int, list[float]] = {}

    def catch_up(self) -> "Follower":
        changes = self.store.descriptions.since(self._name, self.revision)
        if changes.recipe != self.recipe:
            self.vectors.clear()
            changes = self.store.descriptions.since(self._name, 0)
        for seq in changes.gone.tolist():
            self.vectors.pop(seq, None)
        assert changes.seqs.tolist() == sorted(set(changes.seqs.tolist()))
        self.vectors.update(zip(changes.seqs.tolist(), changes.vectors.tolist(), strict=True))
        self.revision, self.recipe = changes.revision, changes.recipe
        return self


def ids(views: Iterable[ViewRecord]) -> list[str]:
    """Ids of views, in their order."""
    return [view.id for view in views]
