"""Images of a ROS 2 recording with where they were taken."""

import math
from bisect import bisect_left
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial

from schemas.records import Position, ViewAttributes
from worker.images.apart.bag import READ, Bag, PoseRow
from worker.images.apart.bag_child import LEAST_UNIX_S
from worker.service.recordings import Item, Note, Recording

ACROSS_S = 2.0
"""Longest gap between two poses that a position is interpolated in, seconds."""

BESIDE_S = 0.2
"""Longest time to the nearest pose where there is none on both sides, seconds."""


def recording_of(bag: Bag) -> Recording:
    """All images of a topic, in the order of the file."""
    poses = sorted(bag.poses, key=_time)
    recording = Recording(bag.close)
    for number, time in enumerate(bag.times_s):
        file = f"{bag.topic} {time:.3f}"
        position = position_at(poses, time, geographic=bag.geographic)
        if position is None and bag.pose_topic is not None:
            detail = f"no pose lies within {BESIDE_S:g} s of it; it has no position"
            recording.notes.append(Note(file, "no-row", detail))
        attributes = ViewAttributes(position=position or Position(), captured_at=_moment(time))
        recording.items.append(Item(file, attributes, partial(bag.read, number)))
    if bag.unread:
        detail = f"holds images of encodings that are not read: {bag.unread}; {READ} are"
        recording.notes.append(Note(bag.topic, "undecodable-picture", detail))
    if bag.broken is not None:
        detail = f"breaks off after {len(bag.times_s):,} images ({bag.broken})"
        recording.notes.append(Note("the file", "malformed-body", detail))
    return recording


def position_at(poses: Sequence[PoseRow], time: float, *, geographic: bool) -> Position | None:
    """Where the camera was: between the poses before and after, in a straight line, or at the nearest.

    Parameters
    ----------
    poses : sequence of PoseRow
        By time.
    time : float
        Seconds.
    geographic : bool
        Whether they are latitudes and longitudes.
    """
    at = bisect_left(poses, time, key=_time)
    before, after = (poses[at - 1] if at else None), (poses[at] if at < len(poses) else None)
    if before is not None and after is not None and _time(after) - _time(before) <= ACROSS_S:
        share = (time - _time(before)) / max(_time(after) - _time(before), 1e-9)
        place = [_between(a, b, share) for a, b in zip(before[1:4], after[1:4], strict=True)]
        if geographic:
            place[1] = _along(before[2], after[2], share)
        return _position(place, before[4] if share < 0.5 else after[4], geographic)
    near = [pose for pose in (before, after) if pose is not None and abs(_time(pose) - time) <= BESIDE_S]
    if not near:
        return None
    nearest = min(near, key=lambda pose: abs(_time(pose) - time))
    return _position(nearest[1:4], nearest[4], geographic)


def _moment(time: float) -> datetime | None:
    return datetime.fromtimestamp(time, UTC) if time >= LEAST_UNIX_S else None


def _time(pose: PoseRow) -> float:
    assert pose[0] is not None
    return pose[0]


def _between(one: float | None, other: float | None, share: float) -> float | None:
    return None if one is None or other is None else one + share * (other - one)


def _along(one: float | None, other: float | None, share: float) -> float | None:
    """Between two longitudes, the short way round the globe, -180..180."""
    if one is None or other is None:
        return None
    round_about = 0.0 if abs(other - one) <= 180 else math.copysign(360.0, one)
    between = one + share * (other + round_about - one)
    return between - round_about if abs(between) > 180 else between


def _position(place: Sequence[float | None], heading: float | None, geographic: bool) -> Position:
    if geographic:
        return Position(lat=place[0], lon=place[1], alt=place[2])
    return Position(x=place[0], y=place[1], z=place[2], heading=heading)
