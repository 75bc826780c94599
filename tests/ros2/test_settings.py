"""Parameters in whatever type launch files and command lines give them."""

from pathlib import Path
from typing import Any

import pytest
from revisit_ros.settings import ENROLL, LOCALIZE, BadParameter, key_of, read


def test_defaults_are_allowed() -> None:
    for parameters in (LOCALIZE, ENROLL):
        assert read(parameters, {}) == {parameter.name: parameter.default for parameter in parameters}


def test_an_empty_value_is_the_default() -> None:
    values = read(LOCALIZE, {"rate": None, "map": None, "drive": None, "landmarks": None})
    assert (values["rate"], values["map"], values["drive"], values["landmarks"]) == (1.0, "default", "", False)


def test_types_of_yaml_are_not_the_users_business() -> None:
    given = {"rate": 2, "map": 7, "drive": "robot-1", "exclude_last": 30, "use_initial_guess": "true", "timeout": "3.5"}
    values = read(LOCALIZE, given | {"hand_over": False})  # YAML reads off as false
    assert (values["rate"], values["map"], values["exclude_last"], values["timeout"]) == (2.0, "7", "30", 3.5)
    assert type(values["rate"]) is float
    assert (values["use_initial_guess"], values["hand_over"]) == (True, "off")


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("rate", -1, "at least 0"),
        ("rate", float("nan"), "a number"),
        ("rate", True, "a number"),
        ("rate", "often", "a number"),
        ("precision", 0.3, "0.5 to 0.999"),
        ("zoom", 0.2, "0.25 to 4"),
        ("zoom", 4.5, "0.25 to 4"),
        ("precision", 1.0, "0 to 0.999"),
        ("timeout", 0, "at least 0.1"),
        ("image_transport", "theora", "compressed, raw"),
        ("camera_forward", "y", "not one of z, x"),
        ("hand_over", "always", "off, topic, service"),
        ("landmarks", "yes", "true or false"),
    ],
)
def test_what_cannot_be_used_is_named_with_what_can(name: str, value: Any, told: str) -> None:
    with pytest.raises(BadParameter, match=told) as refused:
        read(LOCALIZE, {name: value})
    assert str(refused.value).startswith(name)


def test_all_that_is_wrong_is_told_at_once() -> None:
    with pytest.raises(BadParameter) as refused:
        read(ENROLL, {"rate": 0, "every_metres": 0, "queue": 0.5})
    assert [part.split()[0] for part in str(refused.value).split("; ")] == ["every_metres", "rate", "queue"]


@pytest.mark.parametrize("given", [{"base_frame": ""}, {"odom_frame": ""}, {"odom_frame": "map"}])
def test_a_transform_needs_three_frames(given: dict[str, str]) -> None:
    # Launch files hand an empty value on as an empty text where YAML does not make None of it.
    with pytest.raises(BadParameter, match="publish_tf needs map_frame, odom_frame and base_frame"):
        read(LOCALIZE, given | {"publish_tf": True})
    read(LOCALIZE, given)


def test_the_key_comes_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("rv_secret\n")
    assert key_of({"key_file": str(file), "key": "other"}) == "rv_secret"
    assert key_of({"key_file": "", "key": " rv_other "}) == "rv_other"
    assert key_of({"key_file": "", "key": ""}) is None


@pytest.mark.parametrize("content", [None, b"", b" \n", b"\xff\xfe"])
def test_a_key_file_that_holds_none_is_told(content: bytes | None, tmp_path: Path) -> None:
    file = tmp_path / "key"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(BadParameter, match="key_file"):
        key_of({"key_file": str(file), "key": ""})
