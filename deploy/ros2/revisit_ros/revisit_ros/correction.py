"""The transform from map to odom: what a recognised place says of where odometry began, and how long that holds."""

from dataclasses import dataclass, replace

from revisit_ros.frames import FORWARD, Transform, level, yaw_of
from revisit_ros.health import OK, WARN, Report
from revisit_ros.pose import UNKNOWN, NoPose, Pose


def map_to_odom(pose: Pose, base: Transform) -> Transform | NoPose:
    """Where odometry's frame lies in the map, so that the base is where a picture was recognised.

    Both frames are level, as REP 105 has them: of the base in odom, position and yaw count, whatever its roll and pitch
    are. Where the map has no heights, both are at the same height.

    Parameters
    ----------
    pose : Pose
        Of the base in the map.
    base : Transform
        The base in odom, at the stamp of the image.

    Returns
    -------
    Transform or NoPose
        NoPose where something is missing that a transform cannot leave open.
    """
    if not pose.of_base:
        return NoPose(
            "no map to odom: where the camera sits in base_frame is not known", "publish its static transform"
        )
    if pose.yaw is None:
        return NoPose(
            "no map to odom: the pose has no heading, and a transform cannot leave the yaw open",
            "enrol views with headings, as the node enroll does",
        )
    if pose.variances[0] >= UNKNOWN:
        return NoPose(
            "no map to odom: how far off the pose may be is not known",
            "enrol more views: the map has one position alone",
        )
    yaw = yaw_of(base, FORWARD["x"])
    if yaw is None:
        return NoPose(
            "no map to odom: base_frame stands on end in odom_frame", "look at the transform from odom to base"
        )
    x, y, z = pose.position
    if pose.variances[2] >= UNKNOWN:
        z = base.z
    return level((x, y, z), pose.yaw).after(level((base.x, base.y, base.z), yaw).inverse())


@dataclass(frozen=True)
class Held:
    """A transform from map to odom, and when the image arrived that it came from, in seconds of a clock."""

    transform: Transform
    since: float


class Correction:
    """The transform from map to odom that holds now.

    Parameters
    ----------
    hold_s : float
        Seconds for which a transform holds after its image arrived; 0: until the next transform.
    """

    def __init__(self, hold_s: float) -> None:
        self._hold_s = hold_s
        self._held: Held | None = None
        self.note = ""
        """Why the last match gave no transform, for /diagnostics; empty where it gave one."""

    def take(self, transform: Transform, since: float) -> None:
        """Replace the transform by that of an image which arrived at `since`."""
        self._held, self.note = Held(transform, since), ""

    def current(self, now: float) -> Transform | None:
        """The transform that holds; None before the first, and when the last is too old."""
        held = self._held
        return None if held is None or 0 < self._hold_s < now - held.since else held.transform

    def added_to(self, report: Report, now: float) -> Report:
        """A report for /diagnostics with whether a transform is published, which is a warning where none is."""
        values = {"map_to_odom": "no match yet" if self._held is None else "published"}
        if self._held is not None:
            values["map_to_odom_age"] = f"{now - self._held.since:.1f}"
        missing = self.note
        if self.current(now) is None:
            values["map_to_odom"] = values["map_to_odom"].replace("published", "too old")
            missing = missing or f"map to odom is not published: {self._why()}"
        if not missing or report.values["state"] != "working":
            return replace(report, values=report.values | values)
        message = missing if report.level == OK else f"{report.message}; {missing}"
        return Report(WARN, message, report.values | values)

    def _why(self) -> str:
        if self._held is None:
            return "no match has given one yet"
        return f"the last match is older than transform_hold ({self._hold_s:g} s)"
