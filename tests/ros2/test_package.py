"""The package as colcon and launch see it, and its page: what one names, the other has."""

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from revisit_ros.settings import ENROLL, LOCALIZE, Parameter

from app.version import VERSION
from tests.ros2 import fake_rclpy, fake_tf2, interfaces
from tests.test_words import BANNED_NAMES, BANNED_PARTS, names, parts

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "deploy" / "ros2" / "revisit_ros"
PAGE = (ROOT / "docs" / "ros2.md").read_text()
MODULES = sorted((PACKAGE / "revisit_ros").glob("*.py"))
LAUNCHES = sorted((PACKAGE / "launch").iterdir())
OF_ROS = {"messages", "node", "localize_node", "enroll_node"}
OPTIONAL = {"autoware_localization_msgs", "nav2_msgs", "rtabmap_msgs", "vision_msgs"}
NODES: dict[str | None, tuple[Parameter, ...]] = {"localize": LOCALIZE, "enroll": ENROLL}


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add((node.module or "").partition(".")[0])
    return found


def test_all_that_can_do_without_ros_imports_nothing_of_it() -> None:
    allowed = set(sys.stdlib_module_names) | {"revisit_client", "revisit_ros"}
    strays = {path.stem: imported(path) - allowed for path in MODULES if path.stem not in OF_ROS}
    assert {name: found for name, found in strays.items() if found} == {}


def test_what_is_imported_is_declared() -> None:
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    declared = {one.text for one in package.findall("exec_depend")}
    ours = set(sys.stdlib_module_names) | {"revisit_client", "revisit_ros"}
    wanted = set().union(*(imported(path) for path in MODULES)) - ours
    assert wanted <= declared
    assert declared - wanted == {"launch_xml", "ros2launch"}
    assert OPTIONAL.isdisjoint(declared)
    assert package.findtext("export/build_type") == "ament_python"


def set_up(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What setup.py tells setuptools."""
    given: dict[str, Any] = {}
    monkeypatch.setattr("setuptools.setup", lambda **options: given.update(options))
    monkeypatch.chdir(PACKAGE)
    exec(compile((PACKAGE / "setup.py").read_text(), "setup.py", "exec"), {})
    return given


def test_setup_installs_the_marker_the_manifest_and_every_launch_file(monkeypatch: pytest.MonkeyPatch) -> None:
    given = set_up(monkeypatch)
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert given["name"] == package.findtext("name") == "revisit_ros"
    assert given["version"] == package.findtext("version") == VERSION
    assert given["license"] == package.findtext("license")
    placed = dict(given["data_files"])
    assert placed["share/ament_index/resource_index/packages"] == ["resource/revisit_ros"]
    assert placed["share/revisit_ros"] == ["package.xml"]
    assert placed["share/revisit_ros/launch"] == [f"launch/{path.name}" for path in LAUNCHES]
    assert all((PACKAGE / file).is_file() for files in placed.values() for file in files)
    for script in given["entry_points"]["console_scripts"]:
        name, _, module = script.partition(" = ")
        assert name in NODES
        assert module == f"revisit_ros.{name}_node:main"


@pytest.mark.parametrize("path", LAUNCHES, ids=lambda path: path.name)
def test_a_launch_file_uses_what_it_declares_and_sets_what_the_nodes_have(path: Path) -> None:
    text = path.read_text()
    root = ElementTree.fromstring(text)
    arguments = {one.attrib["name"] for one in root.findall("arg")}
    assert set(re.findall(r"\$\(var (\w+)\)", text)) == arguments
    assert re.findall(r"\$\((?!var )", text) == []
    assert path.name.removesuffix(".launch.xml") in PAGE
    nodes = root.findall("node")
    assert nodes
    for node in nodes:
        assert node.attrib["pkg"] == "revisit_ros"
        known = {parameter.name: parameter for parameter in NODES[node.get("exec")]}
        for one in node.findall("param"):
            value = one.attrib["value"]
            argument = re.fullmatch(r"\$\(var (\w+)\)", value)
            given = value if argument is None else root.find(f"arg[@name='{argument[1]}']").attrib["default"]  # type: ignore[union-attr]
            known[one.attrib["name"]].read(given)
        remapped = {one.attrib["from"] for one in node.findall("remap")}
        assert {"image", "image/compressed"} <= remapped <= {"image", "image/compressed", "landmark_detection"}


def rows(parameters: tuple[Parameter, ...]) -> list[str]:
    """The rows that docs/ros2.md has to have."""
    written = []
    for parameter in parameters:
        default = parameter.default
        text = (
            str(default).lower()
            if isinstance(default, bool)
            else f"{default:g}"
            if isinstance(default, float)
            else default
        )
        written.append(f"| `{parameter.name}` | {f'`{text}`' if text else ''} | {parameter.description} |")
    return written


@pytest.mark.parametrize("parameters", NODES.values(), ids=["localize", "enroll"])
def test_the_page_has_every_parameter(parameters: tuple[Parameter, ...]) -> None:
    assert [row for row in rows(parameters) if row not in PAGE.splitlines()] == []


def test_stand_ins_have_no_name_that_the_nodes_take_for_their_own() -> None:
    """Nor has rclpy's Node: a node that overwrote one would work here and not on a robot."""
    taken = {
        *("handle", "context", "executor", "publishers", "subscriptions", "clients", "services", "timers", "guards"),
        *("waitables", "default_callback_group", "_parameters", "_descriptors", "_logger", "_clock", "_time_source"),
        *("_parameter_overrides", "_allow_undeclared_parameters", "_parameter_service", "_parameter_event_publisher"),
        *("_on_set_parameters_callbacks", "_default_callback_group", "_context", "_rate_group", "_logging_service"),
        *("_pre_set_parameters_callbacks", "_post_set_parameters_callbacks", "_type_description_service"),
        *("_enable_logger_service", "_declare_parameter_common", "_get_parameter", "_validate_qos_or_depth_parameter"),
    } | set(dir(fake_rclpy.Node))
    for path in MODULES:
        if path.stem in OF_ROS:
            for one in ast.walk(ast.parse(path.read_text())):
                if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store):
                    assert one.attr not in taken, f"{path.name}: {one.attr}"
                if isinstance(one, ast.FunctionDef) and one.name != "__init__":
                    assert one.name not in taken, f"{path.name}: {one.name}"


def test_everything_of_ros_that_is_imported_has_a_stand_in() -> None:
    there = fake_rclpy.modules() | fake_tf2.modules() | interfaces.modules()
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module in there:
                assert {alias.name for alias in node.names} <= set(dir(there[node.module])), path.name


def test_files_are_short_and_words_are_ours() -> None:
    for path in MODULES:
        assert len(path.read_text().splitlines()) <= 400
        assert ast.get_docstring(ast.parse(path.read_text()))
        found = {name for name in names(path) if name in BANNED_NAMES or parts(name) & BANNED_PARTS}
        assert found == set(), path.name
