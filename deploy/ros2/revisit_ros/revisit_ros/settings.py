"""The parameters of both nodes: names, defaults, meaning, and what they may be."""

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from revisit_ros.frames import FORWARD

Value = bool | float | str


class BadParameter(ValueError):
    """A parameter that cannot be used: its name, what it is, what it may be."""


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Parameters
    ----------
    name, description : str
    default : bool, float or str
        Its type is the parameter's: launch files and command lines write 1 for 1.0 and 7 for "7".
    among : tuple of str
        All that it may be; empty: anything.
    least, most : float
        Bounds of a number.
    """

    name: str
    default: Value
    description: str
    among: tuple[str, ...] = ()
    least: float = 0.0
    most: float = math.inf

    def read(self, given: Any) -> Value:
        """What was given, in the type of the default.

        Raises
        ------
        BadParameter
        """
        if given is None:  # an empty value of a launch file or of YAML
            return self.default
        if isinstance(self.default, bool):
            words = {"true": True, "false": False}
            value = given if isinstance(given, bool) else words.get(str(given).lower())
            if value is None:
                raise BadParameter(f"{self.name} is {given!r}, not true or false")
            return bool(value)
        if isinstance(self.default, float):
            try:
                number = math.nan if isinstance(given, bool) else float(given)
            except (TypeError, ValueError):
                number = math.nan
            if not (math.isfinite(number) and self.least <= number <= self.most):
                bounds = f"at least {self.least:g}" if self.most == math.inf else f"{self.least:g} to {self.most:g}"
                raise BadParameter(f"{self.name} is {given!r}, not a number, {bounds}")
            return number
        text = str(given).lower() if isinstance(given, bool) else str(given)  # off is a boolean in YAML
        text = "off" if text == "false" and "off" in self.among else text
        if self.among and text not in self.among:
            raise BadParameter(f"{self.name} is {given!r}, not one of {', '.join(self.among)}")
        return text


COMMON = (
    Parameter("url", "", "address of the service; empty: `REVISIT_URL`, or `http://127.0.0.1:8000`"),
    Parameter("key_file", "", "file that holds the key; empty: `key`"),
    Parameter("key", "", "the key itself, which every node of the graph can read; empty: `REVISIT_KEY`, or none"),
    Parameter("map", "default", "the map that is searched, or enrolled into"),
    Parameter("map_frame", "map", "frame of the map's positions"),
    Parameter(
        "image_transport",
        "compressed",
        "`compressed` listens to `image/compressed`, `raw` to `image`",
        ("compressed", "raw"),
    ),
    Parameter(
        "camera_forward",
        "z",
        "axis of the image's frame along which the camera looks: `z` (optical, REP 103) or `x` (a body's)",
        tuple(FORWARD),
    ),
    Parameter("timeout", 10.0, "seconds that a call may take", least=0.1),
    Parameter("silence", 5.0, "seconds without images after which /diagnostics tells", least=0.1),
    Parameter("landmarks", False, "whether places are published as `rtabmap_msgs/LandmarkDetection`"),
    Parameter(
        "landmark_radius",
        5.0,
        "metres from its place at which a landmark may be seen, where the service does not know",
        least=0.01,
    ),
)

LOCALIZE = (
    *COMMON,
    Parameter("base_frame", "base_link", "frame whose pose is published; empty: the camera's"),
    Parameter("rate", 1.0, "queries a second at most; 0: only when triggered"),
    Parameter("precision", 0.0, "share of matched answers that must be right, 0.5 to 0.999; 0: the map's", most=0.999),
    Parameter(
        "zoom",
        1.0,
        "how many times as large the camera shows things as [the map's](verdicts.md#another-camera), .25 to 4",
        least=0.25,
        most=4.0,
    ),
    Parameter("drive", "", "name of a [drive](drives.md), so that the evidence of images adds up; empty: none"),
    Parameter("exclude_last", "", "newest views to leave out, a number or `30s`, where the same run is being enrolled"),
    Parameter("use_initial_guess", False, "whether queries search near the last pose on the trigger's topic alone"),
    Parameter("max_age", 2.0, "seconds after which an image that waits is dropped"),
    Parameter(
        "hand_over",
        "off",
        "who gets the first pose, and the first after a trigger: `topic` initialpose, `service` set_initial_pose, "
        "`autoware` localization/initialize",
        ("off", "topic", "service", "autoware"),
    ),
    Parameter("hand_over_every", False, "whether every pose is handed over"),
    Parameter("classification", False, "whether places are published as `vision_msgs/Classification`"),
    Parameter("publish_tf", False, "whether the transform from `map_frame` to `odom_frame` is published"),
    Parameter("odom_frame", "odom", "odometry's frame, in which TF has to place `base_frame`"),
    Parameter(
        "transform_tolerance", 0.1, "seconds that the published transform is stamped ahead of the clock", most=10.0
    ),
    Parameter("transform_rate", 20.0, "times a second that it is published", least=0.1, most=200.0),
    Parameter("transform_hold", 0.0, "seconds after the last match that it is published; 0: until the next one"),
)

ENROLL = (
    *COMMON,
    Parameter("every_metres", 1.0, "metres from one view to the next", least=0.01),
    Parameter("every_degrees", 45.0, "turn after which a view is taken too; 0: never", most=180.0),
    Parameter("rate", 2.0, "views a second at most", least=0.01),
    Parameter("place", "", "name of the place of all views; empty: none"),
    Parameter("queue", 50.0, "views that wait while the service is slow or away", least=1.0, most=10000.0),
    Parameter("tf_wait", 1.0, "seconds that an image waits for the transform at its stamp"),
)


def read(parameters: tuple[Parameter, ...], given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters by name.

    Raises
    ------
    BadParameter
        With all that cannot be used.
    """
    values: dict[str, Any] = {}
    wrong = []
    for parameter in parameters:
        try:
            values[parameter.name] = parameter.read(given.get(parameter.name, parameter.default))
        except BadParameter as error:
            wrong.append(str(error))
    precision = values.get("precision", 0.0)
    if 0 < precision < 0.5:
        wrong.append(f"precision is {precision:g}, not 0.5 to 0.999, or 0 for the map's")
    if values.get("publish_tf"):
        frames = [str(values.get(name, "unset")) for name in ("map_frame", "odom_frame", "base_frame")]
        if "" in frames or len(set(frames)) < 3:
            wrong.append(f"publish_tf needs map_frame, odom_frame and base_frame, all different, and they are {frames}")
    if wrong:
        raise BadParameter("; ".join(wrong))
    return values


def key_of(values: Mapping[str, Any], opened: Callable[[Path], str] = Path.read_text) -> str | None:
    """The key to call with; None leaves it to the client, which reads REVISIT_KEY.

    Raises
    ------
    BadParameter
        The file cannot be read, or is empty.
    """
    if not values["key_file"]:
        return str(values["key"]).strip() or None
    path = Path(os.path.expanduser(values["key_file"]))
    try:
        key = opened(path).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadParameter(f"key_file {path} cannot be read: {error}") from None
    if not key:
        raise BadParameter(f"key_file {path} is empty")
    return key
