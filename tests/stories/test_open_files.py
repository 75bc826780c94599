"""A service that may open no more files goes on when it may again, and its log stays small."""

import os
import resource
import socket
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from tests.stories.running import RunningService

CONNECTIONS = 40
ROOM = 8


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="NOT RUN: limits of a running process are Linux's")
def test_callers_wait_while_no_file_can_be_opened_and_are_answered_then(tmp_path: Path) -> None:
    with RunningService(tmp_path) as service, ExitStack() as stack:
        place = httpx.URL(service.url)
        httpx.get(f"{service.url}/maps").raise_for_status()
        before = resource.prlimit(service.pid, resource.RLIMIT_NOFILE)
        used = 1 + max(map(int, os.listdir(f"/proc/{service.pid}/fd")))
        resource.prlimit(service.pid, resource.RLIMIT_NOFILE, (used + ROOM, before[1]))
        waiting = [
            stack.enter_context(socket.create_connection((place.host, place.port), timeout=20))
            for _ in range(CONNECTIONS)
        ]
        for one in waiting:
            one.sendall(b"GET /livez HTTP/1.1\r\nHost: revisit\r\nConnection: close\r\n\r\n")
        answered = [one.recv(64)[:12] for one in waiting[:ROOM]]
        assert answered == [b"HTTP/1.1 200"] * ROOM
        resource.prlimit(service.pid, resource.RLIMIT_NOFILE, before)
        assert {one.recv(64)[:12] for one in waiting[ROOM:]} == {b"HTTP/1.1 200"}
        httpx.get(f"{service.url}/maps").raise_for_status()
        said = "".join(service.output)
        assert said.count("no connection can be accepted (Too many open files)") == 1
        assert "out of system resource" not in said
