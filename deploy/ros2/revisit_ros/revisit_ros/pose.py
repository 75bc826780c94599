"""From an answer of the service to a pose with covariance, and from a guess to where it searches."""

import math
from dataclasses import dataclass

from revisit_client.wire import QueryAnswer

from revisit_ros.frames import Transform, Vector, base_of_camera, yaw_of, yaw_of_heading

UNKNOWN = 9999.0
"""Variance of what is not known, as RTAB-Map has it."""

HEADING_SD = math.radians(20)
"""By how much a camera that matches a view may be turned against it, standard deviation; as in revisit_client.loops."""

LEAST_GUESS_M = 20.0
"""Smallest radius that a guess narrows the search to: below that, the neighbours that tell places apart are missing."""

GUESS_SD = 3.0
"""Standard deviations of a guess that are searched."""


@dataclass(frozen=True)
class Pose:
    """A pose in the map, level, and how well it is known.

    Parameters
    ----------
    position : (float, float, float)
        Metres.
    yaw : float or None
        Radians counter-clockwise from +x; None where no view that matches has a heading.
    variances : six floats
        Of x, y, z in m^2 and of the rotations about them in rad^2; `UNKNOWN` where nothing is known.
    of_base : bool
        Whether it is that of the robot's base; else of the camera.
    note : str
        What is missing to know more; empty where nothing is.
    """

    position: Vector
    yaw: float | None
    variances: tuple[float, float, float, float, float, float]
    of_base: bool
    note: str = ""

    def covariance(self) -> list[float]:
        """6 x 6, row by row."""
        return diagonal(self.variances)


@dataclass(frozen=True)
class NoPose:
    """Why an answer gives no pose, and what to do."""

    detail: str
    remedy: str


@dataclass(frozen=True)
class Guess:
    """Where the robot takes itself to be: metres in the map's frame."""

    x: float
    y: float
    radius_m: float


def diagonal(variances: tuple[float, ...]) -> list[float]:
    """A covariance of 6 x 6, row by row, with nothing outside its diagonal."""
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(6)]


def pose_of(
    answer: QueryAnswer, mount: Transform | None, forward: Vector, *, base_wanted: bool = True
) -> Pose | NoPose:
    """The pose that a matched answer gives: where the views that match were taken.

    The service tells the camera's position within a radius, which is the root mean square of both axes together, so
    that each has half of its square. The heading is that of the first match.

    Parameters
    ----------
    answer : QueryAnswer
    mount : Transform or None
        The camera in the robot's base; None where that is not known: the pose is then the camera's.
    forward : vector
        Where the camera looks in its own frame (`frames.FORWARD`).
    base_wanted : bool
        Whether the base's pose is wanted, so that a missing mount is worth a note.
    """
    if answer.status != "matched":
        return NoPose(f"{answer.status}: {answer.reason.detail}", answer.reason.remedy)
    if answer.estimate is None:
        return NoPose("the views that match have no position", "enrol them with x and y, as the node enroll does")
    at = answer.estimate.position
    if at.x is None or at.y is None:
        return NoPose(
            "the map's positions are degrees, which are no pose in a frame of ROS",
            "enrol with x and y in metres of map_frame, or ask for GeoPose over HTTP",
        )
    radius = answer.estimate.radius_m
    spread = UNKNOWN if radius is None else radius**2 / 2
    heading = answer.matches[0].view.position.heading if answer.matches and answer.matches[0].view.position else None
    yaw = None if heading is None else yaw_of_heading(heading)
    camera = at.x, at.y, at.z or 0.0
    notes = []
    if radius is None:
        notes.append("how far off it may be is not known: the map has one position alone")
    if yaw is None:
        notes.append("the views that match have no heading, so the yaw is not known")
    position = camera
    if mount is None and base_wanted:
        notes.append("where the camera sits in the base frame is not known, so the pose is the camera's")
    if mount is not None:
        mount_yaw = yaw_of(mount, forward)
        if mount_yaw is None and yaw is not None:
            yaw = None
            notes.append("the camera looks up or down, so the yaw is not known")
        if yaw is not None and mount_yaw is not None:
            position, yaw = base_of_camera(camera, yaw, mount, mount_yaw)
        else:
            # The base lies around the camera, nobody knows on which side: each axis gets half of the distance's square.
            position = camera[0], camera[1], camera[2] - mount.z
            spread = min(UNKNOWN, spread + (mount.x**2 + mount.y**2) / 2)
    height = UNKNOWN if at.z is None else spread
    turn = UNKNOWN if yaw is None else HEADING_SD**2
    return Pose(position, yaw, (spread, spread, height, UNKNOWN, UNKNOWN, turn), mount is not None, "; ".join(notes))


def guess_of(x: float, y: float, covariance: list[float]) -> Guess:
    """Where to search for a guess with a covariance of 6 x 6: three standard deviations, `LEAST_GUESS_M` at least.

    Raises
    ------
    ValueError
        Numbers that are not finite, or a negative variance.
    """
    if not all(map(math.isfinite, (x, y, *covariance))) or len(covariance) != 36:
        raise ValueError("its numbers are not finite")
    xx, xy, yy = covariance[0], (covariance[1] + covariance[6]) / 2, covariance[7]
    if xx < 0 or yy < 0:
        raise ValueError("its variances are negative")
    # The larger eigenvalue: the variance along the longer axis of the ellipse.
    largest = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    return Guess(x, y, max(LEAST_GUESS_M, GUESS_SD * math.sqrt(largest)))
