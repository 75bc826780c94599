"""Fleets of real processes, and callers that remember what was acknowledged to them."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import httpx

from tests.sample_images import photo
from tests.stories.running import RunningService

T = TypeVar("T")

JPEG = {"content-type": "image/jpeg"}


def nodes(
    stack: ExitStack, tmp_path: Path, there: dict[str, str], names: str = "ab"
) -> list[tuple[RunningService, httpx.Client]]:
    """Query nodes, of which none describes, each with a data folder of its own, and callers of them."""
    apart = there | {"REVISIT_INLINE_WORKER": "false"}
    services = [stack.enter_context(RunningService(tmp_path / name, False, **apart)) for name in names]
    return [(one, stack.enter_context(httpx.Client(base_url=one.url, timeout=90))) for one in services]


def until(client: httpx.Client, path: str = "/readyz", status: int = 200, within_s: float = 60) -> None:
    """Wait until a call has this status."""
    deadline = time.monotonic() + within_s
    while True:
        try:
            if client.get(path).status_code == status:
                return
        except httpx.TransportError:
            pass
        assert time.monotonic() < deadline, path
        time.sleep(0.05)


def found(client: httpx.Client, number: int) -> list[str] | None:
    """Views that a query finds; None where the service says that it cannot answer now."""
    answer = client.post("/query", content=photo(number), headers=JPEG)
    if answer.status_code == 503:
        return None
    assert answer.status_code == 200, answer.text
    return [match["view"]["id"] for match in answer.json()["matches"]]


@dataclass
class Ledger:
    """What callers were told, all together."""

    kept: dict[int, str] = field(default_factory=dict)
    deleted: set[str] = field(default_factory=set)
    outcomes: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    longest_s: float = 0.0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def enroll(self, client: httpx.Client, number: int) -> str | None:
        """Enrol an image, and note it if that was acknowledged."""
        answer = self._call(lambda: client.post("/enroll", content=photo(number), headers=JPEG))
        if answer is None or answer.status_code not in (201, 202):
            return None
        view = str(answer.json()["view"]["id"])
        with self._lock:
            self.kept[number] = view
        return view

    def delete(self, client: httpx.Client, number: int) -> str | None:
        """Delete a view that was acknowledged, and note it if that was acknowledged too."""
        view = self.kept[number]
        answer = self._call(lambda: client.delete(f"/views/{view}"))
        with self._lock:
            if answer is None or answer.status_code == 503:
                del self.kept[number]  # it may be gone or there
                return None
            assert answer.status_code in (200, 404), answer.text
            del self.kept[number]
            self.deleted.add(view)
        return view

    def is_ready(self, client: httpx.Client, view: str) -> bool:
        """Whether a view is described, as far as the service can say."""
        answer = self._call(lambda: client.get(f"/views/{view}"))
        return answer is not None and answer.status_code == 200 and answer.json()["state"] == "ready"

    def expect(self, client: httpx.Client, number: int, *, there: str | None = None, gone: str | None = None) -> None:
        """Query, and note an answer that contradicts what was acknowledged before the question."""
        views = self._called(lambda: found(client, number))
        with self._lock:
            if views is None:
                self.outcomes["query refused"] += 1
            elif there is not None and there not in views:
                self.wrong.append(f"{there} was acknowledged and is not found")
            elif gone is not None and gone in views:
                self.wrong.append(f"{gone} was deleted and is found")
            else:
                self.outcomes["query"] += 1

    def compare(self, client: httpx.Client) -> None:
        """All that was acknowledged is there, once; nothing that was deleted is."""
        listed: list[str] = []
        cursor = None
        while True:
            params = {"limit": "200"} if cursor is None else {"limit": "200", "cursor": cursor}
            page = client.get("/views", params=params).json()
            listed += [view["id"] for view in page["views"]]
            cursor = page["next"]
            if cursor is None:
                break
        assert len(listed) == len(set(listed))
        assert set(self.kept.values()) <= set(listed)
        assert not self.deleted & set(listed)
        assert self.wrong == []

    def _call(self, call: Callable[[], httpx.Response]) -> httpx.Response | None:
        answer = self._called(call)
        with self._lock:
            self.outcomes["broken off" if answer is None else str(answer.status_code)] += 1
        return answer

    def _called(self, call: Callable[[], T]) -> T | None:
        began = time.monotonic()
        try:
            return call()
        except httpx.TransportError:  # nothing was acknowledged
            return None
        finally:
            with self._lock:
                self.longest_s = max(self.longest_s, time.monotonic() - began)
