"""What accepting proposals gives: ``./revisit benchmark refreshing --root DIR MAP REFRESHING QUERIES``.

Three walks along one way, frame by frame, in three folders of DIR. The first is enrolled, some frames a place; the
second is queried, and what it matches although it looks unlike is proposed; then the third is queried, before and after
proposals were accepted.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.datasets.dataset import images_in
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.querying import PATIENCE_S
from schemas.records import Position, ViewAttributes
from schemas.settings import Settings
from worker.runtime import Runtime

EXPECTED = (
    "  DIR/MAP/, DIR/REFRESHING/, DIR/QUERIES/   images; number i of each shows the place of number i of the others"
)
TOLERANCE = 2
"""Frames by which a right answer may differ."""

KEPT = 10_000


@dataclass(frozen=True)
class Policy:
    """What is accepted of each proposal: `views` at most, and whether unconfirmed ones too."""

    name: str
    views: int
    unconfirmed: bool


POLICIES = (Policy("confirmed, 3 a place", 3, unconfirmed=False), Policy("all, 10 a place", 10, unconfirmed=True))


@dataclass(frozen=True)
class Row:
    """Shares over the queries: first answers that are right, matched, and right ones of those matched."""

    name: str
    taken: int
    wrong: int
    recall: float
    matched: float
    right: float


def measure(
    runtime: Runtime, walks: Sequence[Sequence[Path]], a_place: int, policies: Sequence[Policy] = POLICIES
) -> list[Row]:
    """The answers to the third walk before and after proposals of the second were accepted.

    Parameters
    ----------
    runtime : Runtime
        Started.
    walks : sequence of sequence of Path
        Three, of equal length.
    a_place : int
        Frames of the first walk that one place has.
    policies : sequence of Policy
        Each gets a map of its own.

    Returns
    -------
    list of Row
        One before anything was accepted, one for each policy.
    """
    base, refreshing, queries = walks
    rows = []
    for number, policy in enumerate(policies):
        name = f"walk-{number}"
        for frame, image in enumerate(base):
            given = ViewAttributes(place=f"place {frame // a_place}", position=Position(x=float(frame), y=0.0))
            runtime.services.enroll.enroll(image.read_bytes(), name, given, patience_s=PATIENCE_S)
        runtime.comparer.all()  # as the service does in the background
        if number == 0:
            rows.append(_row(runtime, name, "none", queries, 0, 0))
        taken, wrong = _refresh(runtime, name, refreshing, policy)
        runtime.comparer.all()
        rows.append(_row(runtime, name, policy.name, queries, taken, wrong))
    return rows


def _refresh(runtime: Runtime, name: str, images: Sequence[Path], policy: Policy) -> tuple[int, int]:
    """Query a walk and accept what is proposed; returns how many views were added, and how many at a wrong frame."""
    services = runtime.services
    services.maps.change(name, keep_matches=KEPT)
    frames = {}
    for frame, image in enumerate(images):
        frames[services.query.query(image.read_bytes(), name).id] = frame
    taken = wrong = 0
    for proposal in services.proposals.of(name).proposals:
        if policy.unconfirmed or proposal.confirmed:
            enrolled, _ = services.proposals.accept(
                name, proposal.queries[0], policy.views, unconfirmed=policy.unconfirmed
            )
            for one in enrolled:
                view = runtime.settlements.wait(one.view.id, PATIENCE_S)
                taken += 1
                true = frames[str(view.attributes.metadata["proposed_by"])]
                wrong += not _near(view.attributes.position.x, true)
    services.maps.change(name, keep_matches=0)
    return taken, wrong


def _row(runtime: Runtime, name: str, title: str, images: Sequence[Path], taken: int, wrong: int) -> Row:
    answers = [runtime.services.query.query(image.read_bytes(), name) for image in images]
    right = [_near(answer.results.views[0].view.attributes.position.x, i) for i, answer in enumerate(answers)]
    matched = [answer.decision.status == "matched" for answer in answers]
    both = sum(a and b for a, b in zip(right, matched, strict=True))
    count = len(answers)
    return Row(title, taken, wrong, sum(right) / count, sum(matched) / count, both / max(1, sum(matched)))


def _near(x: float | None, frame: int) -> bool:
    return x is not None and abs(x - frame) <= TOLERANCE


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="revisit benchmark refreshing", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("walks", nargs=3, metavar="FOLDER", help="enrolled, refreshing, queried: folders of --root")
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--every", type=int, default=1, help="use every n-th frame")
    parser.add_argument("--place", type=int, default=3, help="frames of a place (default: 3)")
    given = parser.parse_args(arguments)
    walks = [images_in(given.root / name, EXPECTED)[:: given.every] for name in given.walks]
    with runtime_for_measuring(Settings()) as runtime:
        print("| accepted | views added | of them wrong | recall@1 | matched | right of those matched |")
        print("|---|---|---|---|---|---|")
        for row in measure(runtime, walks, given.place):
            shares = f"{row.recall:.3f} | {row.matched:.3f} | {row.right:.3f}"
            print(f"| {row.name} | {row.taken} | {row.wrong} | {shares} |")
