"""The files of the fleet fit together. Nothing here starts a container: what they name is compared, not run."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from app.cli.__main__ import parser
from schemas.settings import Settings, read_settings

FLEET = Path(__file__).parents[1] / "deploy" / "fleet"
OURS = ("migrate", "node-a", "node-b", "worker")


@pytest.fixture
def compose() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((FLEET / "compose.yaml").read_text())
    return found


def test_every_process_of_revisit_has_settings_that_are_accepted(compose: dict[str, Any]) -> None:
    for name in OURS:
        service = compose["services"][name]
        given = {key: value for key, value in service["environment"].items() if key.startswith("REVISIT_")}
        read: Settings = read_settings(given)
        assert read.images == "s3://places/images"
        assert read.database is not None
        assert read.database.startswith("postgresql://")
        assert not read.inline_worker
        parser().parse_args(service.get("command", ["serve"]))


def test_with_a_shared_encoder_every_process_has_its_address_and_key(compose: dict[str, Any]) -> None:
    sample = dict(re.findall(r"^(\w+)=(.*)", (FLEET / "sample.env").read_text(), re.MULTILINE))
    text = re.sub(r"\$\{(\w+):\?[^}]*\}", lambda found: sample[found[1]], (FLEET / "encoder.yaml").read_text())
    further = yaml.safe_load(text)["services"]
    encoder = further.pop("encoder")

    parser().parse_args(encoder["command"])
    key = read_settings(encoder["environment"] | {"REVISIT_DEVICE": "cpu"}).encoder_key
    assert set(further) == set(OURS) - {"migrate"}
    for name, service in further.items():
        given = compose["services"][name]["environment"] | service["environment"]
        read = read_settings({each: value for each, value in given.items() if each.startswith("REVISIT_")})
        assert read.encoder_url == f"http://encoder:{read.port}"
        assert read.encoder_key == key
    assert set(encoder["depends_on"]) <= set(compose["services"])


def test_whatever_is_waited_for_and_mounted_is_there(compose: dict[str, Any]) -> None:
    services, volumes = compose["services"], compose["volumes"]
    for service in services.values():
        assert set(service.get("depends_on", ())) <= set(services)
        for volume in service.get("volumes", ()):
            source, _, target = volume.partition(":")
            if source.startswith("."):
                assert (FLEET / source).is_file()
            elif target:
                assert source in volumes
    folders = [services[name]["volumes"][0].partition(":")[0] for name in ("node-a", "node-b")]
    assert len(set(folders)) == 2  # a data folder has one service


def test_nobody_begins_before_the_tables_and_the_bucket_are_there(compose: dict[str, Any]) -> None:
    for name in ("node-a", "worker"):
        waits = compose["services"][name]["depends_on"]
        assert {each["condition"] for each in waits.values()} == {"service_completed_successfully"}
        assert set(waits) == {"migrate", "bucket"}
    assert compose["services"]["node-b"]["depends_on"] == {"node-a": {"condition": "service_healthy"}}


def test_the_balancer_knows_every_node(compose: dict[str, Any]) -> None:
    named = re.findall(r"^ +server ([\w-]+):8000", (FLEET / "nginx.conf").read_text(), re.MULTILINE)
    assert named == [name for name in compose["services"] if name.startswith("node-")]


def test_every_password_comes_from_the_environment_and_is_in_the_sample() -> None:
    text = "".join((FLEET / name).read_text() for name in ("compose.yaml", "encoder.yaml"))
    needed = set(re.findall(r"\$\{(\w+):\?", text))
    assert needed == set(re.findall(r"^(\w+)=", (FLEET / "sample.env").read_text(), re.MULTILINE))
