"""A robot is given a key while the service runs, works with it, and loses it."""

import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.running import ROOT, RunningService, settings, variables
from tests.waiting import until
from worker.runtime import build


def keys(data: Path, *arguments: str) -> str:
    """Run `revisit keys` as the operator would, beside the service."""
    command = [sys.executable, "-m", "app.cli", "keys", *arguments]
    done = subprocess.run(command, cwd=ROOT, env=variables(data), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_robot_gets_a_key_works_and_loses_it(tmp_path: Path) -> None:
    image = encoded(drawn(320, 240, 1), "jpeg")
    with RunningService(tmp_path) as service:
        assert httpx.get(f"{service.url}/maps").status_code == 200  # nobody needs a key yet

        key = keys(tmp_path, "create", "robot", "--scope", "write", "--map", "campus")
        # Within a second, as tests/http/test_keys.py shows by a clock of its own; here other work may delay it.
        until(lambda: httpx.get(f"{service.url}/maps").status_code == 401)

        sent = {"content-type": "image/jpeg", "authorization": f"Bearer {key}"}
        for path in ("/enroll?map=campus", "/query?map=campus"):
            assert httpx.post(f"{service.url}{path}", content=image, headers=sent, timeout=60).status_code in (200, 201)
        assert httpx.post(f"{service.url}/enroll?map=depot", content=image, headers=sent, timeout=60).status_code == 403
        assert httpx.delete(f"{service.url}/maps/campus", headers=sent, timeout=60).status_code == 403

        # The checks are some seconds old.
        until(lambda: "campus" in httpx.get(f"{service.url}/readyz", headers=sent).json()["maps"])
        assert "campus" not in httpx.get(f"{service.url}/readyz").text

        keys(tmp_path, "revoke", "robot")
        until(lambda: httpx.get(f"{service.url}/maps", headers={"x-api-key": key}).status_code == 401)
        assert httpx.get(f"{service.url}/readyz").status_code == 200
    assert key.rpartition("_")[2] not in "".join(service.output)


def test_a_container_prints_its_first_key_once(tmp_path: Path) -> None:
    exposed = {"REVISIT_HOST": "0.0.0.0", "REVISIT_FIRST_KEY": "true"}
    with RunningService(tmp_path, **exposed) as service:
        (key,) = re.findall(r"rv_[0-9a-f]{12}_[0-9A-Za-z]{49}", "".join(service.output))
        assert httpx.get(f"{service.url}/maps").status_code == 401
        assert httpx.get(f"{service.url}/maps", headers={"authorization": f"Bearer {key}"}).status_code == 200
    with RunningService(tmp_path, **exposed) as service:
        assert "rv_" not in "".join(service.output)
        assert httpx.get(f"{service.url}/maps", headers={"authorization": f"Bearer {key}"}).status_code == 200


def test_two_tenants_of_one_service_see_nothing_of_one_another(tmp_path: Path) -> None:
    """Each with an admin key for a map of its own."""
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        made = {
            name: runtime.services.keys.create(name, "admin", datetime.now(UTC), maps=[name])[1]
            for name in ("campus", "depot")
        }

        def call(name: str, method: str, path: str, **sent: Any) -> Any:
            return client.request(method, path, headers={"x-api-key": made[name]}, **sent)

        views, queries = {}, {}
        for seed, name in enumerate(made):
            files = {"image": ("a.jpg", encoded(drawn(320, 240, seed), "jpeg"))}
            views[name] = call(name, "POST", f"/enroll?map={name}&place=gate", files=files).json()["view"]["id"]
            queries[name] = call(name, "POST", f"/query?map={name}&explain=true", files=files).json()["query"]["id"]
        made["operator"] = runtime.services.keys.create("operator", "read", datetime.now(UTC))[1]
        both = call("operator", "POST", "/query?maps=campus,depot&explain=true", files=files).json()["query"]["id"]
        assert call("operator", "GET", f"/queries/{both}/explanation.png").status_code == 200
        for name, other in (("campus", "depot"), ("depot", "campus")):
            for path in ("explanation.png", "changes", "changes.png"):  # it shows the photos of either
                assert call(name, "GET", f"/queries/{both}/{path}").status_code == 404
            for path in ("/maps", "/views", "/places", "/jobs"):
                answer = call(name, "GET", path)
                assert name in answer.text
                assert other not in answer.text
            for path in ("", "/image", "/thumbnail", "/segmentation.png", "/graph.png"):
                assert call(name, "GET", f"/views/{views[name]}{path}").status_code == 200
                assert call(name, "GET", f"/views/{views[other]}{path}").status_code == 404
            assert call(name, "GET", f"/queries/{queries[name]}/explanation.png").status_code == 200
            assert call(name, "GET", f"/queries/{queries[other]}/explanation.png").status_code == 404
            assert call(name, "DELETE", f"/views/{views[other]}").status_code == 404
            assert call(name, "DELETE", f"/maps/{other}").status_code == 403

            def told(view: str, name: str = name) -> str:
                labels = {"queries": [{"view": view, "place": "gate"}]}
                answer = call(name, "POST", f"/maps/{name}/calibration", json=labels)
                assert answer.status_code == 422
                return str(answer.json()["errors"][0]["detail"]).replace(view, "ID")

            assert told(views[other]) == told("0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90")


def test_two_robots_may_call_their_drives_alike(tmp_path: Path) -> None:
    """Each has a key, and both are configured alike: the images of one say nothing of where the other is."""
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        made = {
            name: {"x-api-key": runtime.services.keys.create(name, "write", datetime.now(UTC), maps=["depot"])[1]}
            for name in ("left", "right")
        }
        files = {"image": ("a.jpg", encoded(drawn(320, 240, 1), "jpeg"))}
        assert client.post("/enroll?map=depot", headers=made["left"], files=files).status_code == 201

        def images(name: str) -> int:
            address = "/query?map=depot&drive=robot-1&consistent=2"
            answer = client.post(address, headers=made[name], files=files).json()
            assert answer["drive"]["agreeing"] <= answer["drive"]["images"]
            return int(answer["drive"]["images"])

        assert [images(name) for name in ("left", "right", "left", "right")] == [1, 1, 2, 2]
