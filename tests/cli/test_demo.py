"""What the demo draws, makes of photos, and concludes."""

from pathlib import Path

import pytest
from PIL import Image as PilImage
from revisit_client.wire import QueryAnswer

from app.cli import demo, demo_images
from app.cli.__main__ import main
from app.cli.demo_images import QueryRecord
from tests import answers


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "photos"
    folder.mkdir()
    for i in range(9):
        PilImage.linear_gradient("L").convert("RGB").resize((80, 60)).save(folder / f"{i}.png")
    return sorted(folder.iterdir())


def test_own_photos_are_enrolled_some_held_back_and_altered_copies_queried(photos: list[Path], tmp_path: Path) -> None:
    material = demo_images.of_folder(photos, tmp_path / "out", lambda _: None)

    held_back = [q.path for q in material.queries if not q.known]
    assert held_back == [photos[4]]
    assert [e.path for e in material.enrolments] == [p for p in photos if p not in held_back]
    copies = [q for q in material.queries if q.known]
    assert len(copies) == 8
    for query in copies:
        with PilImage.open(query.path) as image:
            assert image.width >= 32
        assert query.path not in photos


def test_a_folder_that_is_none_and_one_with_too_little(tmp_path: Path) -> None:
    assert main(["demo", "--photos", str(tmp_path / "missing")]) == 2
    assert main(["demo", "--photos", str(tmp_path)]) == 2


@pytest.mark.parametrize(
    ("place", "known", "status", "right"),
    [
        ("square", True, "matched", True),
        ("square", True, "ambiguous", True),
        ("canal", True, "matched", False),
        ("square", True, "no_match", False),
        (None, True, "no_match", True),
        (None, True, "matched", False),
        (None, False, "matched", None),
    ],
)
def test_who_counts_as_recognised(place: str | None, known: bool, status: str, right: bool | None) -> None:
    answer = QueryAnswer.model_validate(answers.query_answer(answers.match(), status=status))

    assert demo.Result(QueryRecord(Path("q.jpg"), place, "", known), answer).is_right is right


def test_each_drawn_place_is_queried_in_one_of_six_ways() -> None:
    from scenes import scene

    ways = [demo_images._change(i, scene(name)) for i, name in enumerate(demo_images.PLACES)]

    assert len({changed for _, changed in ways}) == len(demo_images.PLACES)
    assert all(changed != scene(name) for (_, changed), name in zip(ways, demo_images.PLACES, strict=True))
    for told, changed in ways:
        for thing in ("bus", "car", "person"):
            assert (thing in told) == (thing in changed.things)
