"""Drives beside SeqSLAM: what it claims, what is right of it, the table it stands in, and the orders of a walk."""

from itertools import groupby, pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.baselines.seqslam import SeqSlam
from lab.datasets.dataset import Dataset
from lab.datasets.protocols import halves, whole
from lab.drives import GOING, STANDING, Claims, best_threshold, main, sequences, stop_and_go

HEAD = "query_folder,query_file,database_folder,database_file"


def street(root: Path, count: int = 48) -> Path:
    """Two walks along one drawn street, frame by frame, under noise of their own, as a set of pairs."""
    path = np.random.default_rng(0).normal(size=(count, 32, 64))
    rows = [HEAD]
    for number, folder in enumerate(("day", "dusk")):
        (root / folder).mkdir(parents=True)
        own = np.random.default_rng(number + 1)
        for i in range(count):
            frame = path[i] + 3 * own.normal(size=(32, 64))
            assert cv2.imwrite(str(root / folder / f"{i:03}.png"), np.clip(frame * 25 + 128, 0, 255).astype(np.uint8))
    for i in range(count):
        rows += [f"dusk,{i:03}.png,day,{j:03}.png" for j in range(max(0, i - 1), min(count, i + 2))]
    (root / "ground_truth.csv").write_text("\n".join(rows) + "\n")
    return root


def as_dataset(root: Path, count: int = 48) -> Dataset:
    database, queries = (tuple(root / folder / f"{i:03}.png" for i in range(count)) for folder in ("day", "dusk"))
    near = tuple(np.arange(max(0, i - 1), min(count, i + 2), dtype=np.int64) for i in range(count))
    return Dataset("street dusk -> day", database, queries, near, "+-1")


def test_the_order_is_what_seqslam_knows(tmp_path: Path) -> None:
    trial = whole(as_dataset(street(tmp_path)))
    jumble = np.random.default_rng(0).permutation(48).tolist()
    ordered, jumbled = sequences(trial, range(48), SeqSlam()), sequences(trial, jumble, SeqSlam())
    assert ordered.right[10:].mean() > 0.9
    assert jumbled.right.mean() < 0.5


def test_places_of_the_other_half_are_never_right(tmp_path: Path) -> None:
    first, _ = halves(as_dataset(street(tmp_path)), stretches=2, guard=1)
    claims = sequences(first, range(len(first.queries)), SeqSlam())
    unknown = np.array([query.kind != "known" for query in first.queries])
    assert unknown.any()
    assert not claims.right[unknown].any()


def test_names_of_places_count_too(tmp_path: Path) -> None:
    dataset = as_dataset(street(tmp_path))
    one_place = Dataset(**{**dataset.__dict__, "places": ("street",) * 48})
    assert sequences(whole(one_place), range(48), SeqSlam()).right.all()


def claims(*rows: tuple[float, bool]) -> Claims:
    return Claims(np.array([q for q, _ in rows]), np.array([right for _, right in rows]))


def test_thresholds_by_hand() -> None:
    some = claims((0.5, True), (0.7, True), (0.8, False), (0.9, True), (0.95, True))
    assert str(some.counts()) == "3 of 4 matched right, share 0.75, first 4"
    assert best_threshold([some], 1.0) == 0.7
    assert best_threshold([some], 0.75) == 0.95, "four of five are right"
    assert best_threshold([claims((0.1, False))], 0.97) == 0.0
    # One threshold for all maps, and what has the same quotient is claimed together.
    assert best_threshold([claims((0.5, True)), claims((0.5, False))], 0.97) == 0.0


def test_the_command_prints_a_row_for_each_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pairs", "--root", str(street(tmp_path)), "--no-service"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("| SeqSLAM | without local contrast | shuffled |")
    assert {line.count("|") for line in lines[:-2]} == {13}
    maps = [line.split(" |")[0].rpartition(", ")[2] for line in lines[2:-2]]
    assert maps == ["everything", "half of the places", "half of the places", "everything", "half of the places"]
    assert "matched right, share" in lines[2]
    whole_map, *half_maps = [int(line.rpartition("first ")[2].rstrip(" |")) for line in lines[2:5]]
    assert lines[5].endswith(f"first {whole_map} |")
    assert lines[6].endswith(f"first {sum(half_maps)} |")
    assert lines[-2].startswith("seqslam, all maps: ")
    assert lines[-1].startswith("seqslam without local contrast, all maps: ")


def test_a_drive_with_stops_passes_all_images_in_order_and_stands_at_some() -> None:
    order = stop_and_go(200, np.random.default_rng(5))
    assert list(dict.fromkeys(order)) == list(range(200))
    assert order == sorted(order)
    lengths = [len(list(same)) for _, same in groupby(order)]
    stops = [index for index, length in enumerate(lengths) if length > 1]
    assert all(STANDING[0] <= lengths[index] < STANDING[1] for index in stops)
    assert all(GOING[0] <= later - earlier < GOING[1] for earlier, later in pairwise(stops))
    assert len(stops) > 200 / GOING[1]
