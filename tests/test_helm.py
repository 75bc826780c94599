"""The Helm chart renders what Kubernetes takes and the program understands. No cluster is started here."""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from app.cli.__main__ import parser
from app.version import VERSION
from schemas.settings import read_settings
from tests.http.document import document

kubernetes_validate = pytest.importorskip("kubernetes_validate")

CHART = Path(__file__).parents[1] / "deploy" / "helm" / "revisit"
KUBERNETES = "1.32"
FLEET = ("-f", str(CHART / "examples" / "fleet.yaml"))
OF_THE_OPERATOR = {"ServiceMonitor", "PrometheusRule"}
"""Kinds that Kubernetes itself does not know."""

EXAMPLES: dict[str, tuple[str, ...]] = {
    "one": (),
    "one behind an ingress": ("--set", "ingress.enabled=true,ingress.className=nginx,ingress.tlsSecret=tls"),
    "fleet": FLEET,
    "fleet that grows": (*FLEET, "--set", "nodes.autoscaling.enabled=true,images.endpoint=http://store:9000"),
    "stopped": (*FLEET, "--set", "stopped=true"),
    "fleet that shares encoders": (*FLEET, "--set", "encoders.replicas=2,encoders.secret=e,encoders.tag=gpu"),
    "one with an encoder elsewhere": ("--set", "encoders.url=http://triton:8000"),
    "placed": (
        *FLEET,
        "--set-json",
        'workers.nodeSelector={"gpu":"yes"}',
        "--set-json",
        'workers.tolerations=[{"key":"gpu","operator":"Exists"}]',
    ),
}


def helm(*arguments: str) -> subprocess.CompletedProcess[str]:
    """What `helm` says; it comes with the packages of the extra `dev`."""
    program = shutil.which("helm", path=str(Path(sys.executable).parent)) or shutil.which("helm")
    if program is None:
        pytest.skip("THE HELM CHART IS NOT RENDERED: helm is not installed")
    return subprocess.run([program, *arguments], capture_output=True, text=True, check=False, timeout=60)


def rendered(options: Sequence[str] = ()) -> list[dict[str, Any]]:
    done = helm("template", "revisit", str(CHART), f"--kube-version={KUBERNETES}.0", *options)
    assert done.returncode == 0, done.stderr
    return [found for found in yaml.safe_load_all(done.stdout) if found]


def of_kind(kind: str, options: Sequence[str] = ()) -> list[dict[str, Any]]:
    return [found for found in rendered(options) if found["kind"] == kind]


def pods(options: Sequence[str]) -> list[dict[str, Any]]:
    return [
        found["spec"]["template"]["spec"]
        for found in rendered(options)
        if found["kind"] in ("StatefulSet", "Deployment", "Job")
    ]


@pytest.mark.parametrize("name", EXAMPLES)
def test_kubernetes_takes_what_is_rendered(name: str) -> None:
    linted = helm("lint", "--strict", str(CHART), *EXAMPLES[name])
    assert linted.returncode == 0, linted.stdout

    found = rendered(EXAMPLES[name])

    for each in found:
        if each["kind"] not in OF_THE_OPERATOR:
            kubernetes_validate.validate(each, KUBERNETES, strict=True)
    names = [(each["kind"], each["metadata"]["name"]) for each in found]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_process_is_one_of_ours_with_settings_that_are_accepted(name: str) -> None:
    for pod in pods(EXAMPLES[name]):
        (container,) = pod["containers"]
        parser().parse_args(container["args"])
        secret = {"REVISIT_DATABASE": "postgresql://revisit:secret@database/revisit", "REVISIT_ENCODER_KEY": "k" * 16}
        given = {
            one["name"]: one["value"] if "value" in one else secret[one["name"]]
            for one in container["env"]
            if one["name"].startswith("REVISIT_")
        }
        fleet = not name.startswith("one")
        read = read_settings(given)
        assert read.log == "json"
        if container["args"] == ["encode"]:
            assert set(given) == {"REVISIT_LOG", "REVISIT_ENCODER_KEY"}
            continue
        assert read.inline_worker is not fleet
        assert (read.images is not None) is (read.database is not None) is fleet


def test_what_is_probed_is_a_route_of_the_port_that_is_served() -> None:
    paths = document()["paths"]
    (node,) = (pod["containers"][0] for pod in pods(()))

    assert node["ports"] == [{"name": "http", "containerPort": read_settings({}).port}]
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert node[probe]["httpGet"]["path"] in paths


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_node_that_cannot_enrol_is_still_reached_by_queries_and_deletions(name: str) -> None:
    """`/readyz` says of every node at once that nothing can be enrolled, and a service without nodes answers nobody."""
    nodes = [pod["containers"][0] for pod in pods(EXAMPLES[name]) if pod["containers"][0]["args"] == ["serve"]]
    assert {node["readinessProbe"]["httpGet"]["path"] for node in nodes} == {"/livez"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_no_process_has_more_rights_than_it_needs(name: str) -> None:
    for pod in pods(EXAMPLES[name]):
        assert pod["automountServiceAccountToken"] is False
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert pod["securityContext"]["runAsUser"] == 10001  # the Dockerfile's
        (container,) = pod["containers"]
        assert container["securityContext"]["readOnlyRootFilesystem"] is True
        assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
        mounts = {mount["mountPath"] for mount in container["volumeMounts"]}
        assert mounts == {"/data", "/tmp"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_service_called_revisit_does_not_set_variables_of_the_program(name: str) -> None:
    assert all(pod["enableServiceLinks"] is False for pod in pods(EXAMPLES[name]))


def test_services_find_the_nodes_and_no_worker() -> None:
    (nodes,) = of_kind("StatefulSet", FLEET)
    (workers,) = of_kind("Deployment", FLEET)
    node, worker = (each["spec"]["template"]["metadata"]["labels"] for each in (nodes, workers))

    for service in of_kind("Service", FLEET):
        wanted = service["spec"]["selector"].items()
        assert wanted <= node.items()
        assert not wanted <= worker.items()
    for each, labels in ((nodes, node), (workers, worker)):
        assert each["spec"]["selector"]["matchLabels"].items() <= labels.items()


def test_each_node_is_scraped_once_under_the_job_that_the_alerts_name() -> None:
    (monitor,) = of_kind("ServiceMonitor", FLEET)
    wanted = monitor["spec"]["selector"]["matchLabels"].items()

    (scraped,) = [each for each in of_kind("Service", FLEET) if wanted <= each["metadata"]["labels"].items()]

    assert scraped["metadata"]["labels"][monitor["spec"]["jobLabel"]] == "revisit"
    (rule,) = of_kind("PrometheusRule", FLEET)
    alerts = CHART.parents[1] / "prometheus" / "alerts.yml"
    assert rule["spec"] == yaml.safe_load(alerts.read_text())


def test_nodes_and_workers_send_images_to_the_encoders_and_encoders_to_nobody() -> None:
    options = EXAMPLES["fleet that shares encoders"]
    (service,) = [each for each in of_kind("Service", options) if each["metadata"]["name"].endswith("-encoder")]
    found = {each["metadata"]["name"]: each["spec"]["template"] for kind in ("StatefulSet", "Deployment")
             for each in of_kind(kind, options)}  # fmt: skip
    (encoder,) = found["revisit-encoder"]["spec"]["containers"]

    assert encoder["image"] == "revisit:gpu"
    assert service["spec"]["selector"].items() <= found["revisit-encoder"]["metadata"]["labels"].items()
    for name in ("revisit", "revisit-worker"):
        (container,) = found[name]["spec"]["containers"]
        address = {one["name"]: one.get("value") for one in container["env"]}["REVISIT_ENCODER_URL"]
        assert address == f"http://{service['metadata']['name']}:{service['spec']['ports'][0]['port']}"
        assert container["image"] != encoder["image"]
    (elsewhere,) = (pod["containers"][0] for pod in pods(EXAMPLES["one with an encoder elsewhere"]))
    assert {"name": "REVISIT_ENCODER_URL", "value": "http://triton:8000"} in elsewhere["env"]


def test_what_is_scaled_has_no_number_of_its_own_and_what_is_stopped_has_none_left() -> None:
    growing = EXAMPLES["fleet that grows"]
    scaled = {each["spec"]["scaleTargetRef"]["name"] for each in of_kind("HorizontalPodAutoscaler", growing)}

    assert scaled == {"revisit", "revisit-worker"}
    for each in (*of_kind("StatefulSet", growing), *of_kind("Deployment", growing)):
        assert "replicas" not in each["spec"]
    for each in (*of_kind("StatefulSet", EXAMPLES["stopped"]), *of_kind("Deployment", EXAMPLES["stopped"])):
        assert each["spec"]["replicas"] == 0
    assert of_kind("HorizontalPodAutoscaler", EXAMPLES["stopped"]) == []


REFUSED = {
    "several nodes need a database": "nodes.replicas=2",
    "workers need a database": "workers.replicas=1",
    "is of a fleet": "images.location=s3://places",
    "its machines share no disk": "database.secret=d,workers.replicas=1",
    "its nodes describe nothing": "database.secret=d,images.location=s3://places",
    "REVISIT_DATA is set by the chart": "settings.REVISIT_DATA=/data",
    "least is more than": (
        "database.secret=d,images.location=s3://p,workers.autoscaling.enabled=true,workers.autoscaling.least=99"
    ),
    "encoders need encoders.secret": "encoders.replicas=1",
    "of an encoder elsewhere": "encoders.replicas=1,encoders.secret=e,encoders.url=http://triton:8000",
    "colour": "colour=red",
    "location": "images.location=/mnt/places",
}


@pytest.mark.parametrize("reason", REFUSED)
def test_values_that_do_not_fit_are_refused_with_the_reason(reason: str) -> None:
    refused = helm("template", "revisit", str(CHART), "--set", REFUSED[reason])

    assert refused.returncode != 0
    assert reason in refused.stderr


def test_the_chart_is_of_this_version() -> None:
    chart = yaml.safe_load((CHART / "Chart.yaml").read_text())

    assert (chart["version"], chart["appVersion"]) == (VERSION, VERSION)


@pytest.mark.parametrize("name", ["one behind an ingress", "fleet"])
def test_an_ingress_takes_the_largest_body_and_waits_for_its_answer(name: str) -> None:
    (ingress,) = of_kind("Ingress", EXAMPLES[name])
    prefix = "nginx.ingress.kubernetes.io/proxy-"
    given = {key.removeprefix(prefix): value for key, value in ingress["metadata"]["annotations"].items()}
    assert given["body-size"] == f"{read_settings({}).max_import_mb:.0f}m"
    assert given["request-buffering"] == "off"
    assert int(given["read-timeout"]) > read_settings({}).wait
