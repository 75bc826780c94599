"""Loop closures: which keyframes count, and what the pose graph says of them."""

import math
import re
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given, strategies as st
from revisit_client import ClientError, Revisit, RevisitProblem
from revisit_client.loops import Keyframe, Loop, LoopCloser, csv, g2o, with_headings

from tests import answers
from worker.service.agreement import Row

IMAGE = b"a picture"


FIRST = 50
"""Number of the first keyframe that may be recognised."""


class Service:
    """Recognises keyframe FIRST + n as the n-th keyframe of its list; None is no match, a refusal is raised.

    The view of a keyframe has its number as its id. Of a drive it tells how many in a row agree, as the service does.
    """

    def __init__(self, seen: Sequence[int | dict[str, Any] | None], radius_m: float | None = 3.0) -> None:
        self.seen, self.radius_m = [None] * FIRST + list(seen), radius_m
        self.kept: list[dict[str, Any]] = []
        self.queries: list[bytes] = []
        self.enrolled: list[bytes] = []
        self.row = Row()
        self.refuses = self.loses = False
        self.told: dict[str, httpx.Response] = {}

    def __call__(self, request: httpx.Request) -> httpx.Response:
        key = request.headers.get("idempotency-key", "")
        if request.url.path != "/query" or not key:
            return self._answer(request)
        if key not in self.told:
            self.told[key] = self._answer(request)
        if self.loses:
            raise httpx.ReadError("the network is away")
        return httpx.Response(200, content=self.told[key].content)

    def _answer(self, request: httpx.Request) -> httpx.Response:
        if request.url.path == "/views":
            return httpx.Response(200, json={"views": self.kept, "next": None})
        if request.url.path == "/enroll" and self.refuses:
            return httpx.Response(409, json=answers.problem("conflict", 409))
        if request.url.path == "/enroll":
            self.enrolled.append(request.url.query + request.content)
            return httpx.Response(201, json=answers.enrolled(view_id=str(len(self.enrolled) - 1)))
        self.queries.append(request.content)
        seen = self.seen[len(self.queries) - 1]
        if isinstance(seen, dict):
            return httpx.Response(seen["status"], json=seen)
        self.row = self.row.followed_by(seen)
        alone = "no_match" if seen is None else "matched"
        drive = {
            "images": 1,
            "posterior": [],
            "nowhere": 0.5,
            "single_frame_status": alone,
            "agreeing": self.row.images,
        }
        told: dict[str, Any] = {"drive": drive} if b'name="drive"' in request.content else {}
        wanted = re.search(rb'name="consistent"\r\n\r\n(\d+)', request.content)
        if seen is None:
            return httpx.Response(200, json=answers.query_answer(status="no_match") | told)
        match = answers.match(view_id=str(seen))
        told["estimate"] = {"position": match["view"]["position"], "radius_m": self.radius_m, "views": []}
        if wanted is not None and self.row.images < int(wanted[1]):
            told["status"] = "ambiguous"
        return httpx.Response(200, json=answers.query_answer(match) | told)

    def closer(self, **options: Any) -> LoopCloser:
        revisit = Revisit("http://test", transport=httpx.MockTransport(self), patience=0)
        return LoopCloser(revisit, "walk", **{"consistent": 1, **options})


def walked(service: Service, **options: Any) -> LoopCloser:
    """A walk along x."""
    closer = service.closer(**options)
    at_once = [loop for number in range(len(service.seen)) for loop in closer.add(IMAGE, Keyframe(number, number, 0))]
    assert at_once == closer.loops
    return closer


def found(service: Service, **options: Any) -> list[tuple[int, int]]:
    return [(loop.keyframe - FIRST, loop.earlier) for loop in walked(service, **options).loops]


def test_a_matched_keyframe_is_a_loop_with_the_radius_of_the_service() -> None:
    service = Service([None, 7])

    (loop,) = walked(service).loops

    assert loop == Loop(FIRST + 1, 7, loop.confidence, 3.0)
    assert len(service.enrolled) == FIRST + 2
    assert b'{"keyframe": 51}' in service.enrolled[-1]
    assert b'"exclude_last"\r\n\r\n20\r\n' in service.queries[0]


def test_the_first_keyframe_makes_the_map() -> None:
    service = Service([None])
    service.seen[0] = answers.problem("not-found", 404)

    assert found(service) == []
    assert len(service.enrolled) == FIRST + 1


def test_another_refusal_is_raised_and_nothing_is_enrolled() -> None:
    service = Service([])
    service.seen[0] = answers.problem("unauthorized", 401)

    with pytest.raises(RevisitProblem):
        walked(service)
    assert service.enrolled == []


def test_a_map_with_another_walk_is_refused_before_anything_is_enrolled() -> None:
    service = Service([None])
    service.kept = [answers.view(), answers.view(metadata={"keyframe": 0})]

    with pytest.raises(ClientError, match="map walk holds keyframes of another walk"):
        walked(service)
    assert service.enrolled == service.queries == []


def test_views_that_are_no_keyframes_may_be_there_already_and_are_no_loops() -> None:
    service = Service([900, None])
    service.kept = [answers.view(metadata={"camera": "left"})]

    assert found(service) == []


def test_one_keyframe_that_stands_alone_is_no_loop_where_three_must_agree() -> None:
    # 3 stands alone; 40, 41, 43 agree; 44 goes on; 9 is elsewhere.
    service = Service([None, 3, None, 40, 41, 43, 44, 9, None])

    assert found(service, consistent=3) == [(3, 40), (4, 41), (5, 43), (6, 44)]


def test_a_walk_may_come_back_the_other_way() -> None:
    assert found(Service([44, 41, 36]), consistent=3) == [(0, 44), (1, 41), (2, 36)]
    assert found(Service([44, 38, 37]), consistent=3) == []


def test_the_service_counts_keyframes_in_a_row_of_a_drive_of_this_walk() -> None:
    one, other = Service([40, 41]), Service([40, 41])

    assert found(one, consistent=2) == found(other, consistent=2, drive="robot-7") == [(0, 40), (1, 41)]

    names = [
        {re.search(rb'name="drive"\r\n\r\n([^\r]+)', sent)[1] for sent in service.queries}  # type: ignore[index]
        for service in (one, other)
    ]
    assert names[1] == {b"robot-7"}
    assert len(names[0]) == 1
    assert names[0].isdisjoint(names[1])
    assert all(b'name="consistent"\r\n\r\n2\r\n' in sent for sent in one.queries)


def test_a_keyframe_that_was_counted_and_not_enrolled_draws_no_earlier_one_in() -> None:
    """3 stands alone; 40, 41, 42 agree, and 41 is refused after the service has counted it."""
    service = Service([3, 40, 41, 42])
    closer = service.closer(consistent=3)
    for number in range(len(service.seen)):
        service.refuses = number == FIRST + 2
        with pytest.raises(RevisitProblem) if service.refuses else nullcontext():
            closer.add(IMAGE, Keyframe(number, number, 0))

    assert [(loop.keyframe - FIRST, loop.earlier) for loop in closer.loops] == [(1, 40), (3, 42)]


def test_a_keyframe_whose_answer_was_lost_draws_no_earlier_one_in() -> None:
    """The service has counted it, and the robot drives on: what stood alone before it is no loop."""
    service = Service([7, 30, 31, 32])
    closer = service.closer(consistent=2)
    for number in range(len(service.seen)):
        service.loses = number == FIRST + 1
        with pytest.raises(ClientError) if service.loses else nullcontext():
            closer.add(IMAGE, Keyframe(number, number, 0))
    assert [(loop.keyframe - FIRST, loop.earlier) for loop in closer.loops] == [(2, 31), (3, 32)]


def test_a_keyframe_that_is_added_again_until_it_is_enrolled_counts_once() -> None:
    service = Service([40, 41, 42])
    closer = service.closer(consistent=3)
    found: list[Loop] = []
    for number in range(len(service.seen)):
        for service.refuses in (True, True, False):
            with pytest.raises(RevisitProblem) if service.refuses else nullcontext():
                found += closer.add(IMAGE, Keyframe(number, number, 0))
        assert len(closer.loops) == (3 if number == FIRST + 2 else 0)

    assert [(loop.keyframe - FIRST, loop.earlier) for loop in found] == [(0, 40), (1, 41), (2, 42)]
    assert len(service.queries) == len(service.seen)


def test_a_first_keyframe_that_was_enrolled_while_its_answer_got_lost_is_of_this_walk() -> None:
    service = Service([])
    closer = service.closer()
    service.refuses = True
    with pytest.raises(RevisitProblem):
        closer.add(IMAGE, Keyframe(0, 0, 0))
    service.refuses, service.kept = False, [answers.view(metadata={"keyframe": 0})]

    closer.add(IMAGE, Keyframe(0, 0, 0))

    assert [one.number for one in closer.keyframes] == [0]


def test_walks_share_no_answers() -> None:
    service = Service([40, 41, 42])
    for closer in (service.closer(consistent=3), service.closer(consistent=3)):
        closer.add(IMAGE, Keyframe(0, 0, 0))

    assert len(service.queries) == 2


def test_as_a_drive_each_keyframe_counts_by_itself() -> None:
    service = Service([7])

    assert found(service, consistent=None, drive="robot-7") == [(0, 7)]

    assert all(b'name="drive"' in sent and b'name="consistent"' not in sent for sent in service.queries)


def test_what_was_seen_is_kept_whether_it_counts_or_not() -> None:
    closer = walked(Service([None, 3, 4]), consistent=3)

    assert closer.loops == []
    assert [loop and loop.earlier for loop in closer.seen[FIRST:]] == [None, 3, 4]


def test_where_odometry_is_trusted_only_what_is_near_is_looked_for() -> None:
    service = Service([])

    service.closer(within_m=30).add(IMAGE, Keyframe(0, 1.5, -2))

    assert b'"near"\r\n\r\n1.5,-2,30\r\n' in service.queries[0]
    assert b'"frame"\r\n\r\nmap\r\n' in service.queries[0], "metres, though the map may hold views in degrees"


def test_where_the_service_knows_no_radius_the_callers_is_taken() -> None:
    (loop,) = walked(Service([1], radius_m=None), radius_m=9).loops

    assert loop.radius_m == 9


@pytest.mark.parametrize(
    "options",
    [
        {"consistent": 0},
        {"consistent": 101},
        {"radius_m": 0},
        {"radius_m": math.nan},
        {"within_m": -3},
        {"within_m": math.inf},
    ],
    ids=str,
)
def test_options_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(options))} is"):
        Service([]).closer(**options)


@pytest.mark.parametrize("pose", [(math.nan, 0, None), (0, math.inf, None), (0, 0, math.nan)], ids=str)
def test_poses_are_finite(pose: tuple[float, float, float | None]) -> None:
    with pytest.raises(ValueError, match="keyframe 7"):
        Keyframe(7, *pose)


def test_numbers_of_keyframes_grow() -> None:
    service = Service([])
    closer = service.closer()
    closer.add(IMAGE, Keyframe(4, 0, 0))

    with pytest.raises(ValueError, match="keyframe 4 comes after 4"):
        closer.add(IMAGE, Keyframe(4, 1, 0))
    assert len(service.queries) == 1


def test_headings_are_those_of_the_way() -> None:
    square = [Keyframe(0, 0, 0), Keyframe(1, 0, 1), Keyframe(2, 1, 1), Keyframe(3, 1, 1), Keyframe(4, 2, 1, 45)]

    assert [one.heading for one in with_headings(square)] == [0, 90, 90, 90, 45]


def edges(text: str) -> list[tuple[int, int, list[float]]]:
    lines = [line.split() for line in text.splitlines() if line.startswith("EDGE_SE2")]
    return [(int(line[1]), int(line[2]), [float(word) for word in line[3:]]) for line in lines]


def vertices(text: str) -> dict[int, tuple[float, float, float]]:
    lines = [line.split() for line in text.splitlines() if line.startswith("VERTEX_SE2")]
    return {int(line[1]): (float(line[2]), float(line[3]), float(line[4])) for line in lines}


def test_a_pose_graph_has_odometry_and_loops() -> None:
    walk = [Keyframe(3, 0, 0, 0), Keyframe(5, 0, 2, 90), Keyframe(9, 2, 2, 90)]

    text = g2o(walk, [Loop(9, 3, 0.99, 2.0)])

    assert vertices(text) == {
        3: (0, 0, pytest.approx(math.pi / 2, abs=1e-6)),  # north is a quarter turn from x
        5: (0, 2, 0),
        9: (2, 2, 0),
    }
    assert {line.split()[0] for line in text.splitlines()} == {"VERTEX_SE2", "EDGE_SE2"}
    first, second, loop = edges(text)
    assert first[:2] == (3, 5)
    assert first[2][:3] == pytest.approx([2, 0, -math.pi / 2], abs=1e-6)  # two metres ahead, then to the right
    assert first[2][3:] == pytest.approx([100, 0, 0, 100, 0, 1 / math.radians(2) ** 2], rel=1e-4)
    assert (second[0], second[1]) == (5, 9)
    # The radius is the root mean square of x and y together: 2 metres, of which each has the half, squared.
    assert loop[:2] == (3, 9)
    assert loop[2] == pytest.approx([0, 0, 0, 0.5, 0, 0, 0.5, 0, 1 / math.radians(20) ** 2], rel=1e-4)


def test_a_guessed_heading_says_next_to_nothing_of_how_a_loop_is_turned() -> None:
    walk = [Keyframe(0, 0, 0, 0), Keyframe(1, 0, 2), Keyframe(2, 0, 4), Keyframe(3, 0, 0)]

    *_, with_one_known, with_none = edges(g2o(walk, [Loop(3, 0, 0.99, 2.0), Loop(3, 1, 0.99, 2.0)]))

    assert with_one_known[2][-1] == with_none[2][-1] == pytest.approx(1 / math.pi**2, rel=1e-4)


def test_yaw_and_heading_are_the_same_thing_the_other_way_round() -> None:
    text = g2o([Keyframe.of_pose(0, 1, 2, 0.75), Keyframe.of_pose(1, 1, 2, -3)], [])

    assert [pose[2] for pose in vertices(text).values()] == pytest.approx([0.75, -3], abs=1e-6)
    assert edges(text)[0][2][3] == 1e4  # standing still is known to a centimetre


@given(
    st.lists(
        st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.one_of(st.none(), st.floats(0, 359))),
        min_size=2,
        max_size=12,
    )
)
def test_the_steps_lead_from_the_first_pose_to_all_others(poses: list[tuple[float, float, float | None]]) -> None:
    text = g2o([Keyframe(number, *pose) for number, pose in enumerate(poses)], [])

    expected = vertices(text)
    x, y, yaw = expected[0]
    for _, to, (dx, dy, dyaw, *information) in edges(text):
        x, y = x + math.cos(yaw) * dx - math.sin(yaw) * dy, y + math.sin(yaw) * dx + math.cos(yaw) * dy
        yaw += dyaw
        assert (x, y) == pytest.approx(expected[to][:2], abs=0.1)
        upper = np.zeros((3, 3))
        upper[np.triu_indices(3)] = information
        assert np.all(np.linalg.eigvalsh(upper + np.triu(upper, 1).T) > 0)


def test_the_table_names_its_columns() -> None:
    head = "keyframe,earlier,confidence,radius_m,information_xy,information_yaw\n"
    assert csv([Loop(9, 3, 0.5, 2.0)]) == head + "9,3,0.5,2.0,0.5,0.101321\n"
    assert csv([]) == head


def test_the_table_and_the_graph_know_the_same_of_a_loop() -> None:
    walk = [Keyframe(0, 0, 0, 0), Keyframe(1, 0, 2), Keyframe(2, 0, 4, 10)]
    loops = [Loop(2, 0, 0.99, 3.0), Loop(2, 1, 0.99, 0.7)]

    rows = [line.split(",") for line in csv(loops, walk).splitlines()[1:]]

    in_graph = [edge[2][3:] for edge in edges(g2o(walk, loops))[-2:]]
    assert [[float(row[4]), 0, 0, float(row[4]), 0, float(row[5])] for row in rows] == in_graph
