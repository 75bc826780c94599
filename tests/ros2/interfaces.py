"""Messages and services of ROS 2 as Python has them: classes made from the fields of their definitions, whose setters
refuse what those of rosidl_generator_py refuse (an int for a float, 35 numbers for a covariance, an int for a byte)."""

import array
import types
from typing import Any

import numpy as np

MESSAGES = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/String": "string data",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position, geometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose, float64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header, geometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header, string child_frame_id, "
    "geometry_msgs/Transform transform",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/CompressedImage": "std_msgs/Header header, string format, uint8[] data",
    "sensor_msgs/Image": "std_msgs/Header header, uint32 height, uint32 width, string encoding, uint8 is_bigendian, "
    "uint32 step, uint8[] data",
    "diagnostic_msgs/KeyValue": "string key, string value",
    "diagnostic_msgs/DiagnosticStatus": "byte level, string name, string message, string hardware_id, "
    "diagnostic_msgs/KeyValue[] values",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header, diagnostic_msgs/DiagnosticStatus[] status",
    "rcl_interfaces/ParameterDescriptor": "string name, uint8 type, string description, "
    "string additional_constraints, bool read_only, bool dynamic_typing",
    "autoware_common_msgs/ResponseStatus": "bool success, uint16 code, string message",
    "vision_msgs/ObjectHypothesis": "string class_id, float64 score",
    "vision_msgs/Classification": "std_msgs/Header header, vision_msgs/ObjectHypothesis[] results",
    "rtabmap_msgs/LandmarkDetection": "std_msgs/Header header, string landmark_frame_id, int32 id, float32 size, "
    "geometry_msgs/PoseWithCovariance pose",
}
"""By name: fields as in the .msg files; constants, and the ranges of a ParameterDescriptor, are left out."""

SERVICES = {
    "std_srvs/Trigger": ("", "bool success, string message"),
    "nav2_msgs/SetInitialPose": ("geometry_msgs/PoseWithCovarianceStamped pose", ""),
    "autoware_localization_msgs/InitializeLocalization": (
        "geometry_msgs/PoseWithCovarianceStamped[] pose_with_covariance, uint8 method",
        "autoware_common_msgs/ResponseStatus status",
    ),
}

RANGES = {"int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1), "uint16": (0, 2**16 - 1), "uint8": (0, 255)}
DEFAULTS: dict[str, Any] = {"string": "", "bool": False, "byte": b"\0", "float32": 0.0, "float64": 0.0} | dict.fromkeys(
    RANGES, 0
)

made: dict[str, type[Any]] = {}


def _stored(kind: str, value: Any) -> Any:
    """A value as a field of this type keeps it; AssertionError as rosidl's setters raise it."""
    if kind.endswith("]"):
        base, _, length = kind[:-1].partition("[")
        if base == "uint8" and isinstance(value, array.array):
            assert value.typecode == "B"
            return value
        assert isinstance(value, list | tuple | bytes | np.ndarray | array.array), f"{kind}: {type(value)}"
        assert not length or len(value) == int(length), f"{kind}: {len(value)} values"
        if base == "uint8":
            return array.array("B", value)
        if base == "float64":
            assert isinstance(value, np.ndarray) or all(isinstance(one, float) for one in value), kind
            return np.array(value, np.float64)
        return [_stored(base, one) for one in value]
    if kind in RANGES:
        low, high = RANGES[kind]
        assert isinstance(value, int), f"{kind}: {value!r}"
        assert low <= value <= high, f"{kind}: {value!r}"
    elif kind in ("float32", "float64"):
        assert isinstance(value, float), f"{kind}: {value!r}"
    elif kind == "byte":
        assert isinstance(value, bytes), f"{kind}: {value!r}"
        assert len(value) == 1, f"{kind}: {value!r}"
    elif kind in ("string", "bool"):
        assert isinstance(value, str if kind == "string" else bool), f"{kind}: {value!r}"
    else:
        assert isinstance(value, made[kind]), f"{kind}: {value!r}"
    return value


def _initial(kind: str) -> Any:
    if kind.endswith("]"):
        base, _, length = kind[:-1].partition("[")
        return _stored(kind, [0.0] * int(length)) if length else array.array("B") if base == "uint8" else []
    return DEFAULTS[kind] if kind in DEFAULTS else made[kind]()


def _made(name: str, definition: str) -> type[Any]:
    fields = {field.split()[1]: field.split()[0] for field in definition.split(", ") if field}

    def initialise(self: Any, **given: Any) -> None:
        assert given.keys() <= fields.keys(), f"{name} has no {given.keys() - fields.keys()}"
        for field, kind in fields.items():
            setattr(self, field, given[field] if field in given else _initial(kind))

    def set_field(self: Any, field: str, value: Any) -> None:
        if field not in fields:
            raise AttributeError(f"{name} has no {field}")
        object.__setattr__(self, field, _stored(fields[field], value))

    return type(name.rpartition("/")[2], (), {"__init__": initialise, "__setattr__": set_field})


for _name, _definition in MESSAGES.items():
    made[_name] = _made(_name, _definition)
for _level, _word in enumerate(("OK", "WARN", "ERROR", "STALE")):
    setattr(made["diagnostic_msgs/DiagnosticStatus"], _word, bytes([_level]))
for _name, (_taken, _answered) in SERVICES.items():
    parts = {"Request": _made(f"{_name}_Request", _taken), "Response": _made(f"{_name}_Response", _answered)}
    made[_name] = type(_name.rpartition("/")[2], (), parts)


def modules() -> dict[str, types.ModuleType]:
    """The packages of messages, by name, as ``sys.modules`` has them."""
    found: dict[str, types.ModuleType] = {}
    for name, kind in made.items():
        package, _, own = name.partition("/")
        inner = f"{package}.{'srv' if name in SERVICES else 'msg'}"
        found.setdefault(package, types.ModuleType(package))
        found.setdefault(inner, types.ModuleType(inner))
        setattr(found[inner], own, kind)
    return found


def message(name: str, **fields: Any) -> Any:
    """A message by the name of its type."""
    return made[name](**fields)
