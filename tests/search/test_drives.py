"""What a drive says is its own: not that of how many views are wanted."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from schemas.comparisons import KnownView, MapLevels
from schemas.records import Position
from worker.method.decision import GROUPED, Decision, PlaceProbability, confidences
from worker.method.places import Places
from worker.method.reasons import SURE, Reason
from worker.service.drives import DRIVEN, LEADS, LEANING, LIKELIER, Driven, Drives

VIEWS, CANDIDATES, THRESHOLD = 200, 45, 0.9
ALONG_A_PATH = {seq: KnownView(None, Position(x=2.0 * seq, y=0.0)) for seq in range(VIEWS)}
NAMED = {seq: KnownView(f"hall {seq // 16}") for seq in range(VIEWS)}


@dataclass(frozen=True)
class Results:
    """What a search found, as far as drives read it."""

    ranking: Any
    views: tuple[int, ...]
    recipe: Any
    maps: tuple[Any, ...] = (SimpleNamespace(number=1),)
    rival: Any = None
    searched: int = VIEWS


def further(results: Any, count: int) -> Any:
    return replace(results, views=tuple(range(count)))


def walk(known: dict[int, KnownView], seed: int) -> Iterator[tuple[Any, float]]:
    """Rankings of a robot's images, and how sure the first place of each is by itself."""
    random, at = np.random.default_rng(seed), 50
    for _ in range(8):
        at += int(random.integers(0, 4))
        ahead = np.arange(at - 10, at + 11)
        others = random.choice(np.setdiff1d(np.arange(VIEWS), ahead), CANDIDATES - len(ahead), replace=False)
        seqs = np.concatenate([ahead, others])
        near = np.abs(seqs - at) < 11
        scores = np.where(near, 0.6 - 0.01 * np.abs(seqs - at), 0.45) + random.normal(0, 0.05, len(seqs))
        best = np.argsort(-scores)
        places = Places({int(seq): known[int(seq)] for seq in seqs}, 5.0)
        found = {"seqs": seqs[best], "order": seqs[best], "scores": scores[best], "reranked": CANDIDATES}
        yield SimpleNamespace(**found, places=places), float(random.uniform(0.1, 0.95))


def alone(ranking: Any, sure: float, shown: int, threshold: float) -> Decision:
    """On an image by itself: its first place, and hardly any other."""
    left, places = 1.0, []
    for number, group in enumerate(ranking.places.group([int(seq) for seq in ranking.seqs[:shown]])):
        share = sure if number == 0 else 0.05 if group[0] < GROUPED else 0.0
        places.append(PlaceProbability(left * share, tuple(group)))
        left *= 1 - share
    status: Any = "matched" if sure >= threshold else "ambiguous" if sure >= 0.4 else "no_match"
    levels = MapLevels(20, 0.3, 0.03, 20)
    return Decision(status, sure, SURE, 0.97, threshold, levels, tuple(places), confidences(places))


def found(ranking: Any, shown: int) -> Any:
    return Results(ranking, tuple(range(shown)), SimpleNamespace(description=SimpleNamespace(id="r")))


def driven(
    known: dict[int, KnownView], seed: int, top: int = 1, threshold: float = THRESHOLD
) -> list[tuple[Decision, Driven, Sequence[int]]]:
    """The answers to a walk, each with the first views by sequence number."""
    drives = Drives(further, now=lambda: 0.0)
    answers: list[tuple[Decision, Driven, Sequence[int]]] = []
    for ranking, sure in walk(known, seed):
        shown = max(top, GROUPED)
        results = found(ranking, shown)
        led, decision, said = drives.follow(("map", "robot"), 60, results, alone(ranking, sure, shown, threshold))
        answers.append((decision, said, [int(ranking.seqs[cast(Any, view)]) for view in led.views[:3]]))
    return answers


@pytest.mark.parametrize("known", [ALONG_A_PATH, NAMED], ids=["along a path", "named"])
@pytest.mark.parametrize("top", [GROUPED + 4, DRIVEN + 5, CANDIDATES])
def test_it_does_not_depend_on_how_many_views_are_wanted(known: dict[int, KnownView], top: int) -> None:
    led = 0
    for seed in range(12):
        for few, many in zip(driven(known, seed), driven(known, seed, top), strict=True):
            assert many[0].status == few[0].status
            assert many[0].confidence == pytest.approx(few[0].confidence)
            assert many[1].posterior[0].probability == pytest.approx(few[1].posterior[0].probability)
            assert many[2] == few[2]
            led += few[0].reason != SURE
    assert led > 10


def test_it_is_sure_only_where_its_confidence_reaches_the_threshold() -> None:
    counted = 0
    for seed in range(12):
        for number, (led, _, _) in enumerate(driven(NAMED, seed)):
            more, said, _ = driven(NAMED, seed, threshold=led.confidence + 1e-7)[number]
            if led.reason != SURE and said.single_status != "matched":
                assert more.status == "ambiguous"
                assert more.confidence == pytest.approx(led.confidence)
                counted += 1
    assert counted > 10


def test_the_place_of_the_drive_comes_first_where_the_image_hardly_tells_one_from_another() -> None:
    """Its verdict is the image's own as long as that place is not likelier than everything else."""
    led = 0
    for seed in range(40):
        for decision, said, _ in driven(NAMED, seed)[1:]:
            likeliest = said.posterior[0].probability
            if said.single_status != "matched" and LEADS <= likeliest < LIKELIER:
                assert decision.status == said.single_status
                assert decision.confidence == pytest.approx(likeliest)
                assert said.posterior[0].views[0] == 0
                led += 1
    assert led > 5


def test_a_look_alike_is_that_of_the_first_place() -> None:
    """Where the place of the drive takes the lead, what the image says of another place is no reason; nor is any place
    that comes second a rival."""
    own = Reason("look-alike", "another place is nearly as good", "look at the rival")
    rival: Any = SimpleNamespace()
    counted = {own: 0, LEANING: 0}
    for seed in range(40):
        drives = Drives(further, now=lambda: 0.0)
        for ranking, sure in walk(NAMED, seed):
            results = replace(found(ranking, GROUPED), rival=rival)
            by_itself = replace(alone(ranking, sure, GROUPED, THRESHOLD), reason=own)
            led, decision, said = drives.follow(("map", "robot"), 60, results, by_itself)
            likeliest = said.posterior[0].probability
            if said.images > 1 and said.single_status != "matched" and LEADS <= likeliest < LIKELIER:
                first, alike = (NAMED[int(ranking.seqs[view])] for view in (cast(int, led.views[0]), 0))
                assert decision.reason == (own if first == alike else LEANING)
                assert decision.reason != own or led.rival is rival
                counted[decision.reason] += 1
    assert min(counted.values()) > 1, counted
