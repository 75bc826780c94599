"""Trajectories as manifests: poses in the formats of TUM's RGB-D benchmark and of KITTI's odometry, given to images.

TUM: ``time tx ty tz qx qy qz qw``, the camera in a world whose z points up. KITTI: the first three rows of a matrix,
twelve numbers, the camera in the frame of the first one, whose y points down; one line for each image. In both the
camera looks along its own z.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import PurePosixPath

from schemas.records import Position, ViewAttributes
from schemas.values import FARTHEST_M, composed, whole_turn
from worker.service.archives import SUFFIXES

NAMES = frozenset(
    {"groundtruth.txt", "trajectory.txt", "poses.txt", "pose.txt", "cameratrajectory.txt", "keyframetrajectory.txt"}
)
"""Names of trajectories, besides those that end with ``.tum``."""

LISTS = frozenset({"rgb.txt", "images.txt"})
"""Names of lists of images: ``time file``."""

DEPTHS = frozenset({"depth.txt"})
"""Names of lists of depth images, in the same form: TUM's benchmark has one for each image, and they show no place."""

TOLERANCE_S = 0.05
"""Seconds between an image and the pose that it gets."""

LEAST_UNIX_S = 1e8
"""Smallest time that counts as Unix time: others are counted from the start of a recording."""

MOST_UNIX_S = 253_402_300_799
"""The end of the year 9999, the last that can be written."""

MOST_POSES = 1_000_000


@dataclass(frozen=True)
class Pose:
    """Where a camera was and where it looked.

    Parameters
    ----------
    x, y, z : float
        Metres, z up.
    heading : float or None
        Degrees clockwise from +y; None where it looks straight up or down.
    time : float or None
        Seconds.
    """

    x: float
    y: float
    z: float
    heading: float | None
    time: float | None = None

    def attributes(self) -> ViewAttributes:
        """As those of a view."""
        moment = None
        if self.time is not None and self.time >= LEAST_UNIX_S:
            moment = datetime.fromtimestamp(self.time, UTC)
        return ViewAttributes(position=Position(x=self.x, y=self.y, z=self.z, heading=self.heading), captured_at=moment)


def is_trajectory(name: str) -> bool:
    """Whether a file is a trajectory by its name."""
    path = PurePosixPath(name.lower())
    return path.name in NAMES or path.suffix == ".tum"


def is_list(name: str) -> bool:
    """Whether a file lists images by their times."""
    return PurePosixPath(name.lower()).name in LISTS


def is_list_of_depths(name: str) -> bool:
    """Whether a file lists depth images by their times."""
    return PurePosixPath(name.lower()).name in DEPTHS


def listed(file: str, times: Mapping[str, float]) -> float | None:
    """The time of a file by a list of `read_list`, which has the end of its path; None where it has none."""
    name = _listed_as(file, times)
    return None if name is None else times[name]


def is_depth(file: str, depths: Mapping[str, float], times: Mapping[str, float]) -> bool:
    """Whether a file is a depth image by lists of both: the one that has more of its path says what it is."""
    deep, plain = _listed_as(file, depths), _listed_as(file, times)
    return deep is not None and (plain is None or len(deep) >= len(plain))


def _listed_as(file: str, times: Mapping[str, float]) -> str | None:
    parts = PurePosixPath(composed(file)).parts
    return next((name for start in range(len(parts)) if (name := "/".join(parts[start:])) in times), None)


def read_poses(name: str, data: bytes) -> list[Pose]:
    """Poses of a trajectory, in its order; raises ValueError with the line that cannot be used."""
    poses: list[Pose] = []
    for number, words in _lines(name, data):
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise ValueError(f"{name}, line {number}: holds something that is no number") from None
        if not all(map(math.isfinite, values)):
            raise ValueError(f"{name}, line {number}: holds {next(v for v in values if not math.isfinite(v))}")
        if len(values) not in (8, 12):
            raise ValueError(f"{name}, line {number}: has {len(values)} numbers; TUM has 8 numbers a line, KITTI 12")
        if max(map(abs, _moved(values))) > FARTHEST_M:
            raise ValueError(f"{name}, line {number}: is further than {FARTHEST_M:g} metres from the origin")
        if poses and (poses[0].time is None) != (len(values) == 12):
            raise ValueError(f"{name}, line {number}: has {len(values)} numbers, other than the first")
        poses.append(_of_tum(name, number, values) if len(values) == 8 else _of_kitti(values))
        if len(poses) > MOST_POSES:
            raise ValueError(f"{name}: has more than {MOST_POSES:,} poses; send the recording in parts")
    if not poses:
        raise ValueError(f"{name}: holds no pose")
    return poses


def read_list(name: str, data: bytes) -> dict[str, float]:
    """Times in seconds by file; raises ValueError, also where an image has two."""
    times: dict[str, float] = {}
    for number, words in _lines(name, data):
        try:
            time, file = float(words[0]), words[1]
            if not math.isfinite(time):
                raise ValueError(words[0])
        except (IndexError, ValueError):
            raise ValueError(f"{name}, line {number}: needs a time and a file") from None
        file = composed(file.replace("\\", "/").removeprefix("./"))
        of_image = PurePosixPath(file).suffix.lower() in SUFFIXES  # COLMAP's images.txt has numbers there
        if times.setdefault(file, time) != time and of_image:
            raise ValueError(f"{name}, line {number}: {file} has two times, {times[file]:g} and {time:g} s")
    return times


def poses_of(files: Sequence[str], poses: Sequence[Pose], times: Mapping[str, float]) -> dict[str, Pose]:
    """The pose of each file; without those that have none.

    Poses with times go to the files nearest in time, whose times are listed or are their names. Others go by number:
    the names of the files where all are numbers, else their order.

    Parameters
    ----------
    files : sequence of str
        In their order.
    poses : sequence of Pose
    times : mapping of the end of a file's path to seconds

    Raises
    ------
    ValueError
        Without times, and there are not as many poses as files; or the names of the files count frames, not seconds.
    """
    if poses[0].time is None:
        return _by_number(files, poses)
    ordered = sorted(poses, key=_time)
    moments = {file: _time_of(file, times) for file in files}
    _check_seconds([file for file in files if listed(file, times) is None], moments, ordered)
    found = {}
    for file, moment in moments.items():
        if moment is not None:
            at = bisect_left(ordered, moment, key=_time)
            near = min(ordered[max(at - 1, 0) : at + 1], key=lambda pose: abs(_time(pose) - moment))
            if abs(_time(near) - moment) <= TOLERANCE_S:
                found[file] = near
    return found


def _by_number(files: Sequence[str], poses: Sequence[Pose]) -> dict[str, Pose]:
    stems = [PurePosixPath(file).stem for file in files]
    if all(stem.isdecimal() for stem in stems):
        numbers = [int(stem) for stem in stems]
        if max(numbers) < len(poses):
            return {file: poses[number] for file, number in zip(files, numbers, strict=True)}
    if len(files) != len(poses):
        raise ValueError(f"{len(poses):,} poses without times do not belong to {len(files):,} images")
    return dict(zip(files, poses, strict=True))


def _time(pose: Pose) -> float:
    return 0.0 if pose.time is None else pose.time


def _check_seconds(named: Sequence[str], moments: Mapping[str, float | None], ordered: Sequence[Pose]) -> None:
    """Raise where the names of files count frames: taken for seconds, some images would lie where others were taken.

    Names that are no numbers say nothing of the others, as that of a plan that lies beside the frames.
    """
    numbers = [file for file in named if moments[file] is not None]
    counted = [moments[file] or 0.0 for file in numbers if PurePosixPath(file).stem.isdecimal()]
    first, last = _time(ordered[0]), _time(ordered[-1])
    inside = sum(first - TOLERANCE_S <= second <= last + TOLERANCE_S for second in counted)
    if len(counted) == len(numbers) and max(counted, default=math.inf) < LEAST_UNIX_S and 4 * inside < 3 * len(counted):
        raise ValueError(
            f"the names of images, such as {numbers[-1]}, are no seconds of it ({first:g} to {last:g} s); list the "
            "time of each image in rgb.txt (time file)"
        )


def _time_of(file: str, times: Mapping[str, float]) -> float | None:
    time, stem = listed(file, times), PurePosixPath(file).stem
    if time is None and "_" in stem:  # 12_10: of two cameras, or of another frame; Python reads 1210
        return None
    try:
        return float(stem) if time is None else time
    except ValueError:
        return None


def _of_tum(name: str, number: int, values: Sequence[float]) -> Pose:
    time, x, y, z, qx, qy, qz, qw = values
    length = qx * qx + qy * qy + qz * qz + qw * qw
    if length < 1e-6:
        raise ValueError(f"{name}, line {number}: its quaternion is 0")
    if time > MOST_UNIX_S:
        raise ValueError(f"{name}, line {number}: its time is {time:g} s, beyond the year 9999; times are seconds")
    # The third column of the rotation's matrix: where the camera's z points.
    east, north = 2 * (qx * qz + qy * qw) / length, 2 * (qy * qz - qx * qw) / length
    return Pose(x, y, z, _heading(east, north), time)


def _moved(values: Sequence[float]) -> Sequence[float]:
    """The position of a pose, metres."""
    return values[1:4] if len(values) == 8 else values[3::4]


def _of_kitti(values: Sequence[float]) -> Pose:
    _, _, right, x, _, _, _, down, _, _, ahead, y = values
    return Pose(x, y, -down, _heading(right, ahead))


def _heading(east: float, north: float) -> float | None:
    return whole_turn(math.degrees(math.atan2(east, north)) % 360) if math.hypot(east, north) > 0.1 else None


def _lines(name: str, data: bytes) -> "list[tuple[int, list[str]]]":
    """Numbers and words of the lines that are neither empty nor comments."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{name}: is no text") from None
    split = [(number, line.split()) for number, line in enumerate(text.splitlines(), start=1)]
    return [(number, words) for number, words in split if words and not words[0].startswith("#")]
