"""What the tutorials show is run as it stands there."""

import csv
import json
import math
import os
import re
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from scenes import scene
from tests.sample_images import photo as small_photo
from tests.stories.photos import photo
from tests.stories.running import ROOT, RunningService

pytestmark = pytest.mark.one_database("they say what to type on one machine")

PAGE_S = 480.0
"""Seconds for all commands of a page: half a minute on a quick machine that has nothing else to do."""

TUTORIALS = ROOT / "docs" / "tutorials"
NAMES = ("mill lane", "the green", "school hill", "chapel row")


def programs(page: str) -> list[str]:
    """The Python programs of a page."""
    return re.findall(r"```python\n(.*?)```", (TUTORIALS / page).read_text(), re.DOTALL)


def ran(folder: Path, service: RunningService, *argv: str) -> str:
    """What a program prints that calls the service."""
    path = os.pathsep.join([str(ROOT / "client"), str(ROOT)])
    clean = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
    env = {**clean, "REVISIT_URL": service.url, "PYTHONPATH": path}
    done = subprocess.run([sys.executable, *argv], cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_museum_guide_knows_its_exhibits(tmp_path: Path) -> None:
    (program,) = programs("museum-guide.md")
    assert len(program.splitlines()) <= 35
    (tmp_path / "guide.py").write_text(program)
    for name in NAMES:
        folder = tmp_path / "exhibits" / name
        folder.mkdir(parents=True)
        (folder / "left.jpg").write_bytes(photo(scene(name).seen_from()))
        (folder / "text.txt").write_text(f"This is {name}.\n")
    (tmp_path / "visitor.jpg").write_bytes(photo(scene("chapel row").seen_from(dx=0.3, turn=2)))
    (tmp_path / "elsewhere.jpg").write_bytes(photo(scene("a street nobody enrolled").seen_from()))

    with RunningService(tmp_path / "data", REVISIT_ENCODER="compact") as service:

        def guide(*argv: str) -> str:
            return ran(tmp_path, service, "guide.py", *argv)

        assert guide("teach") == guide("teach") == f"{len(NAMES)} exhibits"
        assert guide("visitor.jpg") == "chapel row: This is chapel row."
        assert "This is" not in guide("elsewhere.jpg")


SPOTS, AGAIN = 10, 4
RADIUS_M = 4.0
DRIFT_M = 0.5


def test_a_walk_that_comes_back_is_pulled_together(tmp_path: Path) -> None:
    for name, program in zip(("close.py", "relax.py"), programs("loop-closure.md"), strict=True):
        (tmp_path / name).write_text(program)
    (tmp_path / "walk").mkdir()
    true, drifted = [], []
    for number in range(SPOTS + AGAIN):
        spot = scene(f"spot {number % SPOTS}")
        look = spot.seen_from() if number < SPOTS else spot.seen_from(dx=0.3, turn=2)
        file = f"walk/{number:04}.jpg"
        (tmp_path / file).write_bytes(photo(look))
        angle = 2 * math.pi * number / SPOTS
        x, y = RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle)
        true.append((x, y))
        drifted.append((file, x + DRIFT_M * number, y))
    with (tmp_path / "odometry.csv").open("w") as table:
        csv.writer(table).writerows([("file", "x", "y"), *drifted])

    with RunningService(tmp_path / "data", REVISIT_ENCODER="compact") as service:
        told = ran(tmp_path, service, "close.py").splitlines()
        (tmp_path / "relaxed.csv").write_text(ran(tmp_path, service, "relax.py"))
        [line] = re.findall(r"`\./revisit (loops [^`]+)`", (TUTORIALS / "loop-closure.md").read_text())
        said = ran(tmp_path, service, "-m", "app.cli", *line.split()).splitlines()

    assert said[-1] == f"{len(told)} loops among {SPOTS + AGAIN} images"
    closed = [tuple(map(int, re.findall(r"\d+", line)[:2])) for line in told]
    assert len(closed) >= AGAIN - 1
    assert all(keyframe - earlier == SPOTS for keyframe, earlier in closed)
    before = furthest([(x, y) for _, x, y in drifted], true)
    with (tmp_path / "relaxed.csv").open() as table:
        after = furthest([(float(x), float(y)) for x, y in csv.reader(table)], true)
    assert before > 6
    assert after < before / 4, after


def furthest(found: Sequence[tuple[float, float]], true: Sequence[tuple[float, float]]) -> float:
    """The largest distance of a position from the true one, metres, both from where the walk begins."""
    shift = true[0][0] - found[0][0], true[0][1] - found[0][1]
    return max(math.dist((x + shift[0], y + shift[1]), there) for (x, y), there in zip(found, true, strict=True))


def shell(page: str, folder: Path, **environment: str) -> str:
    """What the lines of a page for a shell print, all of them run in one folder."""
    blocks = re.findall(r"```sh\n(.*?)```", (TUTORIALS / page).read_text(), re.DOTALL)
    commands = folder / "commands"
    commands.mkdir()
    (folder / "revisit").write_text(f'#!/bin/sh\nexec {sys.executable} -m app.cli "$@"\n')
    (commands / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    for program in (folder / "revisit", commands / "python"):
        program.chmod(0o755)
    clean = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
    clean |= {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}", "PATH": f"{commands}:{os.environ['PATH']}"}
    port = environment.get("REVISIT_PORT", "8000")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "".join(blocks).replace("localhost:8000", f"localhost:{port}")],
        cwd=folder,
        env=clean | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=PAGE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_an_operator_loses_a_disk_and_nothing_else(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    (tmp_path / "photos").mkdir()
    for number in range(6):
        (tmp_path / "photos" / f"{number}.jpg").write_bytes(small_photo(number))

    told = shell(
        "operator.md",
        tmp_path,
        REVISIT_ENCODER="color",
        REVISIT_PORT=port,
        REVISIT_URL=f"http://127.0.0.1:{port}",
    )

    assert "6 enrolled, 0 already there, 0 failed" in told
    assert "401" in told.splitlines()
    assert 'revisit_views{map="campus",state="ready"} 6.0' in told
    assert len(re.findall(r"\d\.jpg", told.rpartition("doctor")[2])) == 6
    assert (tmp_path / "robot-7.key").stat().st_mode & 0o077 == 0


def test_a_researcher_measures_a_method_of_their_own(tmp_path: Path) -> None:
    [program] = programs("researcher.md")
    (tmp_path / "colours.py").write_text(program)

    told = shell("researcher.md", tmp_path)

    runs = {
        name: json.loads((tmp_path / "runs" / name / "evaluation.json").read_text())[0]["methods"]
        for name in ("evaluation", "mine", "perfect", "rivals")
    }
    names = {name: [method["method"] for method in methods] for name, methods in runs.items()}
    assert names["mine"] == ["random", "colour histogram"]
    assert names["perfect"] == ["ground truth"]
    assert names["rivals"] == ["rootsift vlad", "rootsift vlad, verified", "seqslam"]
    assert names["evaluation"] == ["default", "default, histograms alone", "tiny image", "hog"]
    assert runs["perfect"][0]["recall"][0]["value"] == 1
    assert (tmp_path / "runs" / "evaluation" / "report.html").stat().st_size > 10_000
    assert "query_folder,query_file" in told
