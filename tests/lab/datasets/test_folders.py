"""pairs, aligned and folder: tiny sets in each layout, and what is said when it is not right."""

from pathlib import Path

import numpy as np
import pytest

from lab.datasets import aligned, folder, pairs
from lab.datasets.dataset import Dataset, UnexpectedLayout
from lab.datasets.hold_out import hold_out
from tests.lab.datasets.drawn import image

HEAD = "query_folder,query_file,database_folder,database_file\n"


def a_set_of_pairs(root: Path) -> Path:
    for name in ("q/1.jpg", "q/2.jpg", "q/10.jpg", "d/1.jpg", "d/2.jpg", "d/10.jpg", "e/1.jpg"):
        image(root / name)
    (root / "ground_truth.csv").write_text(
        HEAD + "q,1.jpg,d,10.jpg\nq,1.jpg,d,2.jpg\nq,10.jpg,d,1.jpg\nq,2.jpg,e,1.jpg\n"
    )
    return root


def test_pairs_by_hand(tmp_path: Path) -> None:
    first, second = pairs.read(a_set_of_pairs(tmp_path))
    assert [p.name for p in first.database] == ["1.jpg", "2.jpg", "10.jpg"]
    assert [p.name for p in first.queries] == ["1.jpg", "10.jpg"]
    assert [p.tolist() for p in first.positives] == [[1, 2], [0]]
    assert second.name.endswith("q -> e")
    assert len(second.queries) == 1


def test_pairs_can_ask_what_no_row_names(tmp_path: Path) -> None:
    first, _ = pairs.read(a_set_of_pairs(tmp_path), unlisted=True)
    assert [p.tolist() for p in first.positives] == [[1, 2], [], [0]]


def test_a_folder_of_sets(tmp_path: Path) -> None:
    a_set_of_pairs(tmp_path / "b")
    a_set_of_pairs(tmp_path / "a")
    assert [d.name for d in pairs.read(tmp_path)] == ["a q -> d", "a q -> e", "b q -> d", "b q -> e"]


def test_pairs_say_what_they_expect(tmp_path: Path) -> None:
    with pytest.raises(UnexpectedLayout, match=r"no ground_truth\.csv"):
        pairs.read(tmp_path)
    a_set_of_pairs(tmp_path)
    (tmp_path / "d" / "2.jpg").unlink()
    with pytest.raises(UnexpectedLayout, match=r"1 images that the table names are not there: d/2\.jpg"):
        pairs.read(tmp_path)
    (tmp_path / "ground_truth.csv").write_text("a,b\n1,2\n")
    with pytest.raises(UnexpectedLayout, match="column query_folder"):
        pairs.read(tmp_path)
    (tmp_path / "ground_truth.csv").write_text(HEAD)
    with pytest.raises(UnexpectedLayout, match="no rows"):
        pairs.read(tmp_path)


def test_aligned_counts_frames_in_natural_order(tmp_path: Path) -> None:
    for i in (1, 2, 9, 10, 11):
        image(tmp_path / "database" / f"img{i}.png")
        image(tmp_path / "query" / f"IMG{i}.png")
    [found] = aligned.read(tmp_path, tolerance=1)
    assert [p.name for p in found.database] == ["img1.png", "img2.png", "img9.png", "img10.png", "img11.png"]
    assert [p.tolist() for p in found.positives] == [[0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4]]
    assert found.sequential
    assert not aligned.read(tmp_path, tolerance=0)[0].sequential
    (tmp_path / "query" / "IMG2.png").unlink()
    with pytest.raises(UnexpectedLayout, match="5 images in database, 4 in query"):
        aligned.read(tmp_path)
    with pytest.raises(UnexpectedLayout, match="no such folder"):
        aligned.read(tmp_path, query="night")


def walk(root: Path, rows: str, head: str = "file,x,y,heading") -> Path:
    (root / "positions.csv").write_text(f"{head}\n{rows}\n")
    for row in rows.splitlines():
        if name := row.split(",")[0]:
            image(root / name)
    return root


def test_folder_by_hand(tmp_path: Path) -> None:
    walk(tmp_path, "database/a.jpg,0,0,350\ndatabase/b.jpg,0,30,0\nquery/c.jpg,0,10,20\nquery/d.jpg,500,0,0")
    [found] = folder.read(tmp_path)
    assert [p.tolist() for p in found.positives] == [[0, 1], []]
    [near] = folder.read(tmp_path, radius_m=15)
    assert [p.tolist() for p in near.positives] == [[0], []]
    [facing] = folder.read(tmp_path, heading_tolerance=25)  # 350 and 20 are 30 degrees apart, across north
    assert [p.tolist() for p in facing.positives] == [[1], []]


def test_the_store_that_links_lead_to_is_no_part_of_a_set(tmp_path: Path) -> None:
    walk(tmp_path, "database/a.jpg,0,0,0\nquery/c.jpg,0,10,0")
    kept = tmp_path / ".git" / "annex" / "objects" / "a1.jpg" / "a1.jpg"  # a folder and a file, as git-annex has them
    kept.parent.mkdir(parents=True)
    (tmp_path / "database" / "a.jpg").rename(kept)
    (tmp_path / "database" / "a.jpg").symlink_to(kept)
    assert folder.read(tmp_path)[0].truth == "within 25 m"


def test_images_that_the_table_does_not_name_are_told_of(tmp_path: Path) -> None:
    walk(tmp_path, "database/a.jpg,0,0,0\nquery/c.jpg,0,10,0")
    assert "take no part" not in folder.read(tmp_path)[0].truth
    image(tmp_path / "query" / "d.jpg")
    image(tmp_path / "query" / "._d.jpg")  # what macOS leaves beside it
    image(tmp_path / ".thumbnails" / "a.jpg")
    assert folder.read(tmp_path)[0].truth == "within 25 m; images that positions.csv does not name take no part: 1"


def test_folder_in_degrees(tmp_path: Path) -> None:
    # At 60 degrees north a degree of longitude is half as long: 0.001 degrees are 55.6 m.
    rows = "a.jpg,60,24.999,database\nb.jpg,60,25.0003,database\nc.jpg,60,25,query"
    [found] = folder.read(walk(tmp_path, rows, "file,lat,lon,role"))
    assert [p.tolist() for p in found.positives] == [[1]]
    assert found.database_positions is not None
    assert found.query_positions is not None
    apart = np.linalg.norm(found.database_positions - found.query_positions, axis=1)
    assert apart == pytest.approx([55.6, 16.7], abs=0.1)


def test_what_is_near_is_told_on_the_globe_where_a_set_has_cities_far_apart(tmp_path: Path) -> None:
    # A degree of longitude is 67.7 km in the northern city and 82.8 in the southern one: 23 m, 27 m and the query.
    north = "a.jpg,52.52,13.40034,database\nb.jpg,52.52,13.4004,database\nc.jpg,52.52,13.4,query"
    south = "d.jpg,41.9,12.50028,database\ne.jpg,41.9,12.50033,database\nf.jpg,41.9,12.5,query"
    [found] = folder.read(walk(tmp_path, f"{north}\n{south}", "file,lat,lon,role"))
    assert [p.tolist() for p in found.positives] == [[0], [2]]


def test_folder_stays_together_across_the_date_line(tmp_path: Path) -> None:
    rows = "a.jpg,0,179.9999,database\nb.jpg,0,-179.9999,query"
    [found] = folder.read(walk(tmp_path, rows, "file,lat,lon,role"))
    assert [p.tolist() for p in found.positives] == [[0]]


@pytest.mark.parametrize(
    ("rows", "head", "says"),
    [
        ("database/a.jpg,0\nquery/b.jpg,0", "file,x", "no column y"),
        ("database/a.jpg,0,?\nquery/b.jpg,0,0", "file,x,y", "line 2: y is '\\?'"),
        ("database/a.jpg,0,nan\nquery/b.jpg,0,0", "file,x,y", "line 2: y is 'nan'"),
        ("database/a.jpg,0,0\ndatabase/b.jpg,0,0", "file,x,y", "both roles"),
        ("database/a.jpg,0,0\nother/b.jpg,0,0", "file,x,y", "neither database nor query but 'other'"),
        ("database/a.jpg,0,0\n,,", "file,x,y", "line 3 has no file"),
        ("database/a.jpg,1,5,0\nquery/b.jpg,0,0", "file,x,y", "line 2 has more fields than the heading"),
        ("a.jpg,0,0,database\nb.jpg,0,0,query\na.jpg,0,0,query", "file,x,y,role", "several rows: a.jpg"),
        ("database/a.jpg,0,0\nquery/b.jpg,0,0", "file, x, y", "no column x; there are 'file', ' x', ' y'"),
        ("database/a.jpg,120,20\nquery/b.jpg,120,20", "file,lat,lon", "line 2: lat is not within 90"),
    ],
)
def test_folder_says_what_it_expects(tmp_path: Path, rows: str, head: str, says: str) -> None:
    with pytest.raises(UnexpectedLayout, match=says):
        folder.read(walk(tmp_path, rows, head))


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_a_table_in_another_encoding_is_no_accident(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "positions.csv").write_text("file,x,y\ndatabase/é.jpg,0,0\n", encoding=encoding)
    with pytest.raises(UnexpectedLayout, match=r"byte \d+ is no UTF-8 text; save the table as CSV in UTF-8"):
        folder.read(tmp_path)


def test_a_row_of_pairs_that_ends_early_is_named(tmp_path: Path) -> None:
    a_set_of_pairs(tmp_path)
    with (tmp_path / "ground_truth.csv").open("a") as table:
        table.write("q,10.jpg,d\n")
    with pytest.raises(UnexpectedLayout, match="line 6 has no database_file"):
        pairs.read(tmp_path)


def test_accents_of_files_are_those_of_the_table_however_they_are_written(tmp_path: Path) -> None:
    one, other = "cafe\u0301.jpg", "caf\u00e9.jpg"
    assert one != other
    image(tmp_path / "query" / one)
    image(tmp_path / "database" / one)
    (tmp_path / "positions.csv").write_text(f"file,x,y\ndatabase/{other},0,0\nquery/{other},0,0\n")
    (tmp_path / "ground_truth.csv").write_text(f"{HEAD}query,{other},database,{other}\n")
    for [found] in (folder.read(tmp_path), pairs.read(tmp_path)):
        assert [p.tolist() for p in found.positives] == [[0]]
        assert found.database[0].is_file()


def test_what_only_has_the_name_of_an_image_is_none(tmp_path: Path) -> None:
    for name in ("database", "query"):
        image(tmp_path / name / "a.jpg")
        image(tmp_path / name / "._a.jpg")  # what macOS leaves beside it
    [found] = aligned.read(tmp_path)
    assert [path.name for path in (*found.database, *found.queries)] == ["a.jpg", "a.jpg"]
    (tmp_path / "query" / "b.jpg").symlink_to(tmp_path / "nowhere.jpg")
    with pytest.raises(UnexpectedLayout, match=r"names of images: b\.jpg"):
        aligned.read(tmp_path)


def test_held_out_places_are_nowhere_in_the_database() -> None:
    files = tuple(Path(f"{i}.jpg") for i in range(20))
    whole = Dataset("walk", files, files, tuple(np.arange(max(0, i - 1), min(20, i + 2)) for i in range(20)), "+-1")
    less = hold_out(whole, 0.5, np.random.default_rng(3))
    unanswerable = np.flatnonzero(~less.judged().answerable)
    assert len(unanswerable) >= 8
    absent = {p.name for p in whole.database} - {p.name for p in less.database}
    for query, right in enumerate(less.positives):
        assert {less.database[i].name for i in right} == {
            whole.database[i].name for i in whole.positives[query]
        } - absent
    with pytest.raises(ValueError, match="no database"):
        hold_out(whole, 1.0, np.random.default_rng(0))


@pytest.mark.shared
def test_campus_by_position_gives_the_table_that_came_with_it(shared: Path) -> None:
    root = shared / "data" / "places" / "campus_gps"
    [by_position] = folder.read(root, heading_tolerance=45)
    [by_table] = pairs.read(root)
    named = {
        q.name: {by_table.database[i].name for i in r}
        for q, r in zip(by_table.queries, by_table.positives, strict=True)
    }
    found = {
        q.name: {by_position.database[i].name for i in r}
        for q, r in zip(by_position.queries, by_position.positives, strict=True)
        if len(r)
    }
    assert found == named
