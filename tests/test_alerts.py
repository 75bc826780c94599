"""Prometheus itself evaluates the alerts over series as services print them."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ALERTS = Path(__file__).parents[1] / "deploy" / "prometheus" / "alerts.yml"
PROMTOOL = shutil.which("promtool")

pytestmark = pytest.mark.skipif(PROMTOOL is None, reason="ALERTS ARE NOT TRIED: promtool is not installed")


WORKERS = 'revisit_workers{instance="a"}'
SIGN_OF_LIFE = 'revisit_worker_heartbeat_age_seconds{instance="a"}'


def told(folder: Path, alert: str, minute: int, series: dict[str, str]) -> list[str]:
    """What a rule tells at a minute: the descriptions of its alerts.

    `series` are values by the minute, as Prometheus's own tests of rules write them.
    """
    given = [{"series": name, "values": values} for name, values in series.items()]
    expected = {"eval_time": f"{minute}m", "alertname": alert, "exp_alerts": []}
    rules = {
        "rule_files": [str(ALERTS)],
        "evaluation_interval": "1m",
        "tests": [{"interval": "1m", "input_series": given, "alert_rule_test": [expected]}],
    }
    file = folder / "rules.json"
    file.write_text(json.dumps(rules))  # which is YAML too
    assert PROMTOOL is not None
    tried = subprocess.run([PROMTOOL, "test", "rules", str(file)], capture_output=True, text=True, check=False)
    said = tried.stdout + tried.stderr
    descriptions = re.findall(r'got:\[.*?description="(.*?)"', said, re.DOTALL)
    assert (tried.returncode == 0) == (descriptions == []), said
    return descriptions


def test_workers_that_were_killed_are_told(tmp_path: Path) -> None:
    """A node takes a worker that is gone for dead within the lease, and forgets when it gave a sign of life."""
    gone = {WORKERS: "1 1 0x10", SIGN_OF_LIFE: "1 1 stale _x9"}
    assert len(told(tmp_path, "RevisitWorkerSilent", 6, gone)) == 1


def test_workers_that_cannot_write_are_told(tmp_path: Path) -> None:
    silent = {WORKERS: "2x12", SIGN_OF_LIFE: "1+60x12"}
    assert len(told(tmp_path, "RevisitWorkerSilent", 10, silent)) == 1


def test_workers_that_work_are_not_told(tmp_path: Path) -> None:
    at_work = {WORKERS: "1x12", SIGN_OF_LIFE: "1x12"}
    assert told(tmp_path, "RevisitWorkerSilent", 10, at_work) == []


def failed(map_name: str) -> str:
    return f'revisit_views{{instance="a",map="{map_name}",state="failed"}}'


def test_views_that_fail_are_told_also_those_of_a_map_that_was_just_made(tmp_path: Path) -> None:
    old = {failed("old"): "3x30 3+1x60"}
    new = {failed("old"): "3x90", failed("new"): "_x70 25x20"}
    assert [len(told(tmp_path, "RevisitViewsFailing", 85, series)) for series in (old, new)] == [1, 1]


def test_views_that_failed_before_a_map_was_one_of_the_others_are_not_told_anew(tmp_path: Path) -> None:
    """Twenty maps have series of their own: one that others outgrow joins the series of the rest."""
    joined = {failed("small"): "40x70 stale", failed("(other)"): "2x71 42x20"}
    assert told(tmp_path, "RevisitViewsFailing", 85, joined) == []


def test_a_queue_is_full_with_what_workers_have_taken(tmp_path: Path) -> None:
    """Enrolments are refused by the number of those that are not described yet, also where many workers have some."""
    limit = {'revisit_queue_limit{instance="a",job="revisit",queue="enrolments"}': "1000x20"}
    jobs = 'revisit_jobs{{instance="a",job="revisit",kind="{}",state="{}"}}'.format
    full = {jobs("describe", "waiting"): "520x20", jobs("describe", "running"): "480x20"} | limit
    others = {jobs("describe", "waiting"): "520x20", jobs("redescribe", "waiting"): "9000x20"} | limit
    said = "The queue of a is 100% full; a full one answers 429."
    assert [told(tmp_path, "RevisitQueueFilling", 15, series) for series in (full, others)] == [[said], []]
