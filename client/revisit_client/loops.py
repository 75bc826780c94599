"""Loop closures for SLAM: keyframes go in one by one, constraints of a pose graph come out.

closer = LoopCloser(revisit, "campus", exclude_last=20)
for number, (image, x, y, heading) in enumerate(walk):
    for loop in closer.add(image, Keyframe(number, x, y, heading)):
        print(loop.keyframe, "is where", loop.earlier, "was")
Path("graph.g2o").write_text(g2o(closer.keyframes, closer.loops))
"""

import csv as csv_files
import hashlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any
from uuid import uuid4

from revisit_client.client import Revisit
from revisit_client.errors import ClientError, RevisitProblem
from revisit_client.parameters import Image, named

KEYFRAME = "keyframe"
"""Name in the metadata of a view under which the number of its keyframe is kept."""

HEADING_SD = 20.0
"""Degrees by which the camera of a loop may be turned against the earlier one's, as a standard deviation."""

CONSISTENT = 3
"""Keyframes in a row that must agree, where nothing else is said."""

UNKNOWN_SD = 180.0
"""The same where a heading of the two is guessed: the way may have been walked backwards, or the camera look aside."""


@dataclass(frozen=True)
class Keyframe:
    """A keyframe, and where odometry takes it to be.

    Parameters
    ----------
    number : int
        Of its own; later keyframes have larger ones.
    x, y : float
        Metres, x to the east and y to the north, or in any frame that is turned against these.
    heading : float or None
        Degrees clockwise from y; None: as the next keyframe lies.

    Raises
    ------
    ValueError
        A pose that is not finite.
    """

    number: int
    x: float
    y: float
    heading: float | None = None

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x, self.y, self.heading or 0.0))):
            raise ValueError(f"keyframe {self.number} lies at {self.x}, {self.y}, {self.heading}; poses are finite")

    @classmethod
    def of_pose(cls, number: int, x: float, y: float, yaw: float) -> "Keyframe":
        """A keyframe by its yaw: radians counter-clockwise from x (REP 103)."""
        return cls(number, x, y, (90 - math.degrees(yaw)) % 360)


@dataclass(frozen=True)
class Loop:
    """A keyframe that shows the place of an earlier one.

    Parameters
    ----------
    keyframe, earlier : int
        Numbers.
    confidence : float
        Probability that it is the same place, 0..1.
    radius_m : float
        How far apart the two may be, root mean square, metres.
    """

    keyframe: int
    earlier: int
    confidence: float
    radius_m: float


class LoopCloser:
    """Asks about each keyframe, then enrols it.

    Parameters
    ----------
    revisit : Revisit
    map : str
        Made by the first keyframe. It may hold views already, but none of another walk: one map for one walk, since a
        walk's keyframes compete with those of another for the same place.
    exclude_last : int or str
        Newest views that are no loop: a number, or those enrolled within the last seconds, as ``30s``.
    consistent : int or None
        Keyframes in a row that the service must recognise one by one, the earlier ones at most five views apart from
        one to the next, before they count. None: 3, and 1 as a drive.
    within_m : float or None
        Only keyframes that odometry takes to be as near as this are looked for; None: all.
    radius_m : float
        Of a loop of whose position the service knows no radius, metres.
    drive : str or None
        Count the images together, as those of one drive; with `consistent` its name alone.
    precision : float or None
        Share of loops that must be right; None: as the map says.

    Attributes
    ----------
    keyframes : list of Keyframe
        Those enrolled.
    seen : list of (Loop or None)
        What each of them was recognised as, before `consistent` is asked for.
    loops : list of Loop
        What is certain.

    Raises
    ------
    ValueError
        An option is out of range.
    """

    def __init__(
        self,
        revisit: Revisit,
        map: str,
        *,
        exclude_last: int | str = 20,
        consistent: int | None = None,
        within_m: float | None = None,
        radius_m: float = 5.0,
        drive: str | None = None,
        precision: float | None = None,
    ) -> None:
        if consistent is None:
            consistent = CONSISTENT if drive is None else 1
        if not 1 <= consistent <= 100:
            raise ValueError(f"consistent is {consistent}; it is 1 or more, 100 at most")
        for name, metres in (("within_m", within_m), ("radius_m", radius_m)):
            if metres is not None and not 0 < metres < math.inf:
                raise ValueError(f"{name} is {metres}; it is above 0")
        self._revisit, self._map = revisit, map
        self._exclude_last, self._within_m = exclude_last, within_m
        self._consistent, self._radius_m, self._precision = consistent, radius_m, precision
        self._drive: dict[str, Any] = {} if drive is None else {"drive": drive}
        if consistent > 1:  # a walk may stand still for long
            named = {"drive": drive or f"loops-{uuid4().hex}", "consistent": consistent, "drive_timeout": 86400}
            self._drive = named
        self._walk, self._last_counted, self._begun = uuid4().hex, -math.inf, False
        self._numbers: dict[str, int] = {}
        self.keyframes: list[Keyframe] = []
        self.seen: list[Loop | None] = []
        self._counted: list[Loop | None] = []
        self.loops: list[Loop] = []

    def add(self, image: Image, keyframe: Keyframe) -> list[Loop]:
        """Look for the place of a keyframe among the earlier ones, then enrol it.

        Returns
        -------
        list of Loop
            What is certain now and was not before: of this keyframe and, with `consistent`, of those before it.

        Raises
        ------
        ValueError
            The number is not larger than that of the keyframe before.
        ClientError
            The service refused or did not answer, or the map holds another walk. The keyframe is not among
            `keyframes`, and may be added again: it counts once for `consistent`.
        """
        if not self._begun:  # afterwards the map may hold a keyframe of this one whose answer got lost
            self._refuse_another_walk()
            self._begun = True
        if self.keyframes and keyframe.number <= self.keyframes[-1].number:
            raise ValueError(f"keyframe {keyframe.number} comes after {self.keyframes[-1].number}; numbers grow")
        try:
            seen, agreeing = self._seen(image, keyframe)
        except ClientError as error:
            if not isinstance(error, RevisitProblem) or error.status >= 500:
                self._count(keyframe)  # the answer may have been lost: better one keyframe too many than one too few
            raise
        self._count(keyframe)
        enrolled = self._revisit.enroll(
            image,
            map=self._map,
            x=keyframe.x,
            y=keyframe.y,
            heading=keyframe.heading,
            metadata={KEYFRAME: keyframe.number},
        )
        self._numbers.setdefault(enrolled.view.id, keyframe.number)
        self.keyframes.append(keyframe)
        self.seen.append(seen)
        self._counted[-1] = seen
        at_once = self._consistent if agreeing == self._consistent else 1
        fresh = [one for one in self._counted[-at_once:] if one is not None] if agreeing >= self._consistent else []
        self.loops += fresh
        return fresh

    def _count(self, keyframe: Keyframe) -> None:
        """Remember that the service has counted a keyframe, whether it is enrolled or not."""
        if keyframe.number != self._last_counted:
            self._counted.append(None)
        self._last_counted = keyframe.number

    def _refuse_another_walk(self) -> None:
        try:
            walked = any(KEYFRAME in (view.metadata or {}) for view in self._revisit.views(self._map, page=500))
        except RevisitProblem as problem:
            if problem.code != "not-found":
                raise
            return
        if walked:
            raise ClientError(
                f"map {self._map} holds keyframes of another walk, which would hide this one's loops; "
                "name another map, or delete this one"
            )

    def _key(self, image: Image, keyframe: Keyframe) -> str:
        """The same each time that a keyframe is added, so that the service counts it once."""
        return hashlib.sha256(f"{self._walk} {keyframe}".encode() + named(image)[1]).hexdigest()

    def _seen(self, image: Image, keyframe: Keyframe) -> tuple[Loop | None, int]:
        """What a keyframe is recognised as, and how many in a row agree."""
        try:
            answer = self._revisit.query(
                image,
                map=self._map,
                exclude_last=self._exclude_last,
                near=None if self._within_m is None else (keyframe.x, keyframe.y, self._within_m),
                geographic=None if self._within_m is None else False,  # the map may hold views in degrees too
                precision=self._precision,
                idempotency_key=self._key(image, keyframe) if self._drive else None,
                **self._drive,
            )
        except RevisitProblem as problem:
            if problem.code == "not-found":  # the first keyframe makes the map
                return None, 0
            raise
        status, agreeing = answer.status, int(answer.status == "matched")
        if self._consistent > 1 and answer.drive is not None:
            status, agreeing = answer.drive.single_frame_status, answer.drive.agreeing
        earlier = self._numbers.get(answer.matches[0].view.id) if status == "matched" else None
        if earlier is None:
            return None, agreeing
        radius = None if answer.estimate is None else answer.estimate.radius_m
        return Loop(keyframe.number, earlier, answer.confidence, radius or self._radius_m), agreeing


def with_headings(keyframes: Sequence[Keyframe]) -> list[Keyframe]:
    """The keyframes, each with a heading: for want of one that of the way to the next, at the end as before."""
    found: list[Keyframe] = []
    for number, one in enumerate(keyframes):
        if one.heading is None:
            to = keyframes[number + 1] if number + 1 < len(keyframes) else None
            if to is not None and (to.x, to.y) != (one.x, one.y):
                one = replace(one, heading=math.degrees(math.atan2(to.x - one.x, to.y - one.y)) % 360)
            else:
                one = replace(one, heading=found[-1].heading if found else 0.0)
        found.append(one)
    return found


def g2o(
    keyframes: Sequence[Keyframe],
    loops: Sequence[Loop],
    *,
    drift: float = 0.05,
    turn: float = 2.0,
) -> str:
    """A pose graph in the plane, as g2o, GTSAM and Ceres' examples read it.

    Vertices are the poses of odometry (yaw in radians, counter-clockwise from x). Edges are the steps of odometry, and
    the loops: at the same place, facing the same way. Their information is 2 / radius² in x and y, since the radius is
    the root mean square of both together; in yaw that of 20° where both headings were given, and next to none where one
    is that of the way.

    Parameters
    ----------
    keyframes : sequence of Keyframe
    loops : sequence of Loop
    drift : float
        Standard deviation of a step, as a share of its length (at least a centimetre's).
    turn : float
        Standard deviation of the turn of a step, degrees.

    Returns
    -------
    str
        Lines ``VERTEX_SE2 id x y yaw`` and ``EDGE_SE2 from to dx dy dyaw`` with the upper
        triangle of the information matrix. None fixes a vertex: GTSAM reads no edge of a file with ``FIX``.
    """
    poses = {one.number: (one.x, one.y, _yaw(one)) for one in with_headings(keyframes)}
    lines = [f"VERTEX_SE2 {number} {x:.6f} {y:.6f} {yaw:.6f}" for number, (x, y, yaw) in poses.items()]
    for one, two in zip(list(poses)[:-1], list(poses)[1:], strict=True):
        dx, dy, dyaw = _step(poses[one], poses[two])
        of_place = 1 / max(drift * math.hypot(dx, dy), 0.01) ** 2
        lines.append(_edge(one, two, (dx, dy, dyaw), of_place, 1 / math.radians(turn) ** 2))
    for loop, (of_place, of_yaw) in zip(loops, information(loops, keyframes), strict=True):
        lines.append(_edge(loop.earlier, loop.keyframe, (0, 0, 0), of_place, of_yaw))
    return "\n".join(lines) + "\n"


def information(loops: Sequence[Loop], keyframes: Sequence[Keyframe]) -> list[tuple[float, float]]:
    """What is known of each loop: information of x and of y alike, 1/m², and of yaw, 1/rad².

    The radius is the root mean square of x and y together, so that each has the half of it, squared. Of yaw as much is
    known as of the headings: `keyframes` has those that were given.
    """
    known = {one.number for one in keyframes if one.heading is not None}
    turns = [HEADING_SD if {loop.earlier, loop.keyframe} <= known else UNKNOWN_SD for loop in loops]
    return [(2 / loop.radius_m**2, 1 / math.radians(sd) ** 2) for loop, sd in zip(loops, turns, strict=True)]


def csv(loops: Sequence[Loop], keyframes: Sequence[Keyframe] = ()) -> str:
    """The loops as a table, with the information that `g2o` writes.

    Parameters
    ----------
    loops : sequence of Loop
    keyframes : sequence of Keyframe
        Of which the headings are known; without them next to nothing is known of yaw.

    Returns
    -------
    str
        Columns keyframe, earlier, confidence, radius_m, information_xy (of x and of y alike, 1/m²) and information_yaw
        (1/rad²).
    """
    out = io.StringIO()
    writer = csv_files.writer(out, lineterminator="\n")
    names = [field.name for field in fields(Loop)]
    writer.writerow([*names, "information_xy", "information_yaw"])
    for loop, known in zip(loops, information(loops, keyframes), strict=True):
        writer.writerow([*(getattr(loop, name) for name in names), *(f"{value:.6g}" for value in known)])
    return out.getvalue()


Pose = tuple[float, float, float]


def _yaw(keyframe: Keyframe) -> float:
    return _wrapped(math.radians(90 - (keyframe.heading or 0.0)))


def _step(one: Pose, two: Pose) -> Pose:
    """Pose `two` in the frame of pose `one`."""
    dx, dy = two[0] - one[0], two[1] - one[1]
    cos, sin = math.cos(one[2]), math.sin(one[2])
    return cos * dx + sin * dy, cos * dy - sin * dx, _wrapped(two[2] - one[2])


def _wrapped(angle: float) -> float:
    """An angle in -pi..pi, radians."""
    return math.atan2(math.sin(angle), math.cos(angle))


def _edge(one: int, two: int, step: Pose, of_place: float, of_yaw: float) -> str:
    measured = " ".join(f"{value:.6f}" for value in step)
    return f"EDGE_SE2 {one} {two} {measured} {of_place:.6g} 0 0 {of_place:.6g} 0 {of_yaw:.6g}"
