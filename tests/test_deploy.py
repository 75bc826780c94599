"""The dashboard and the alerts name metrics that exist, and each alert has its advice in docs/operations.md."""

import json
import logging
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from app.cli.logs import _USUAL
from tests.http.fakes import FakeRuntime
from tests.openapi import CheckedClient

ROOT = Path(__file__).parents[1]
ALERTS = ROOT / "deploy" / "prometheus" / "alerts.yml"
DASHBOARD = ROOT / "deploy" / "grafana" / "dashboard.json"
PAGE = ROOT / "docs" / "operations.md"


@pytest.fixture
def printed() -> dict[str, str]:
    """Names of all series that `/metrics` can print, with their types."""
    with CheckedClient(FakeRuntime().app()) as client:
        types = dict(re.findall(r"^# TYPE (\S+) (\S+)$", client.get("/metrics").text, re.MULTILINE))
    ends = {"histogram": ("_bucket", "_sum", "_count")}
    return {name + end: kind for name, kind in types.items() for end in ends.get(kind, ("",))}


def alerts() -> list[dict[str, str]]:
    """The alerts: the file has one field a line."""
    found = []
    for text in ALERTS.read_text().split("- alert: ")[1:]:
        fields = dict(re.findall(r"^ +(\w+): '?(.*?)'?$", text, re.MULTILINE))
        found.append({"alert": text.splitlines()[0], **fields})
    return found


def expressions() -> list[str]:
    panels = json.loads(DASHBOARD.read_text())["panels"]
    drawn = [target["expr"] for panel in panels for target in panel["targets"]]
    return drawn + [alert["expr"] for alert in alerts()]


def metrics_of(expression: str) -> set[str]:
    return set(re.findall(r"\b(?:revisit|process|python)_\w+", expression))


def test_every_metric_that_is_drawn_or_alerted_on_is_printed(printed: dict[str, str]) -> None:
    named = set().union(*(metrics_of(expression) for expression in expressions()))
    assert len(named) > 25
    assert named - printed.keys() == set()


@pytest.mark.parametrize("expression", expressions())
def test_an_expression_is_whole_and_takes_rates_of_counters_alone(expression: str, printed: dict[str, str]) -> None:
    assert all(expression.count(a) == expression.count(b) for a, b in ("()", "{}", "[]"))
    for name in re.findall(r"\b(?:rate|increase)\((\w+)", expression):
        assert printed[name] in ("counter", "histogram"), name
    for name in re.findall(r"\b(?:delta|deriv|predict_linear)\((?:sum by \(\w+\) \()?(\w+)", expression):
        assert printed[name] == "gauge", name


@pytest.mark.parametrize("expression", expressions())
def test_what_each_node_reads_of_one_database_is_not_summed_over_nodes(
    expression: str, printed: dict[str, str]
) -> None:
    for labels, name in re.findall(r"\bsum(?: by \(([\w, ]+)\))? ?\((\w+)\{", expression):
        assert printed[name] != "gauge" or "instance" in labels, name


def test_every_alert_says_what_is_wrong_and_its_page_what_to_do() -> None:
    page = PAGE.read_text()
    headings = {heading.lower(): heading for heading in re.findall(r"^### (\w+)$", page, re.MULTILINE)}
    names = [alert["alert"] for alert in alerts()]
    assert len(set(names)) == len(names) > 10
    for alert in alerts():
        assert alert["severity"] in ("critical", "warning", "info")
        assert alert["summary"]
        assert alert["description"]
        assert alert["runbook_url"] == f"docs/operations.md#{alert['alert'].lower()}"
        assert headings[alert["alert"].lower()] == alert["alert"]
    assert set(headings.values()) == set(names)


def test_the_page_lists_every_metric_of_the_service(printed: dict[str, str]) -> None:
    listed = set(re.findall(r"^\| `(revisit_\w+)", PAGE.read_text(), re.MULTILINE))
    of_histograms = {name.removesuffix("_count") if kind == "histogram" else name for name, kind in printed.items()}
    families = {
        name for name in of_histograms if name.startswith("revisit_") and not re.search(r"_(bucket|sum|created)$", name)
    }
    assert listed == families


def test_the_page_lists_every_field_of_the_line_of_a_request(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "revisit.access"), CheckedClient(FakeRuntime().app()) as client:
        client.get("/maps/none")
    [line] = [record for record in caplog.records if getattr(record, "event", "") == "request"]
    listed = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", PAGE.read_text(), re.MULTILINE))))
    assert set(vars(line)) - _USUAL - {"taskName"} <= listed


def test_promtool_accepts_the_rules_and_the_configuration() -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("RULES ARE NOT CHECKED BY PROMETHEUS: promtool is not installed")
    for what, file in (("rules", ALERTS), ("config", ALERTS.with_name("prometheus.yml"))):
        checked = subprocess.run([promtool, "check", what, str(file)], capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize("name", ["revisit.service", "revisit-worker.service"])
def test_systemd_knows_every_line_of_the_unit(name: str, tmp_path: Path) -> None:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("THE UNIT IS NOT CHECKED: systemd-analyze is not installed")
    unit = (ROOT / "deploy" / name).read_text().replace("/opt/revisit/revisit", "/bin/true")
    for text, fault in ((unit, ""), (unit.replace("ProtectSystem=", "ProtectSystm="), "Unknown key")):
        (tmp_path / name).write_text(text)
        checked = subprocess.run([program, "verify", str(tmp_path / name)], capture_output=True, text=True, check=False)
        said = "".join(line for line in checked.stderr.splitlines() if name in line)
        assert (checked.returncode, fault in said, bool(said)) == (0, True, bool(fault)), checked.stderr


def test_both_units_run_commands_that_there_are_and_differ_in_nothing_else() -> None:
    serve, work = ((ROOT / "deploy" / name).read_text() for name in ("revisit.service", "revisit-worker.service"))
    starts = [re.findall(r"^ExecStart=/opt/revisit/revisit (\w+)$", unit, re.MULTILINE) for unit in (serve, work)]
    assert starts == [["serve"], ["worker"]]
    own = {"Description", "After", "ExecStart", "ExecStartPost", "TimeoutStartSec"}
    kept = [[line for line in unit.splitlines() if line.partition("=")[0] not in own | {""} and line[0] != "#"]
            for unit in (serve, work)]  # fmt: skip
    assert kept[0] == kept[1]


def test_a_start_that_takes_long_is_waited_for_no_longer_but_not_killed() -> None:
    """A large database is migrated for minutes, and with a full disk the service is never ready."""
    unit = (ROOT / "deploy" / "revisit.service").read_text()
    [(bound, line)] = re.findall(r"^ExecStartPost=-/usr/bin/timeout (\d+) /bin/sh -c '(.*)'$", unit, re.MULTILINE)
    [killed] = re.findall(r"^TimeoutStartSec=(\d+)$", unit, re.MULTILINE)
    assert int(bound) + 20 < int(killed)
    ended = subprocess.Popen(["/bin/true"])
    ended.wait()
    for healthy, main, code in (("false", os.getpid(), 124), ("true", os.getpid(), 0), ("false", ended.pid, 0)):
        told = line.replace("/opt/revisit/revisit healthcheck", healthy)
        assert told != line
        waiting = ["timeout", "2", "/bin/sh", "-c", told]
        assert subprocess.run(waiting, env=os.environ | {"MAINPID": str(main)}, check=False).returncode == code


def test_systemd_does_not_give_up_while_the_database_is_away() -> None:
    """It starts nothing more than five times in ten seconds, where a unit does not say otherwise."""
    for name in ("revisit.service", "revisit-worker.service"):
        unit = (ROOT / "deploy" / name).read_text()
        assert "StartLimit" not in unit
        [pause_s] = re.findall(r"^RestartSec=(\d+)$", unit, re.MULTILINE)
        assert 5 * int(pause_s) > 10


def test_neither_unit_waits_for_the_other() -> None:
    """A node counts as started once a worker is alive: one that waited for the node would keep both from starting."""
    units = {"revisit.service", "revisit-worker.service"}
    for name in units:
        unit = (ROOT / "deploy" / name).read_text().splitlines()
        orders = [line for line in unit if line.startswith(("After=", "Before=", "Requires=", "Wants=", "BindsTo="))]
        assert orders
        assert not units & set(" ".join(orders).replace("=", " ").split())
