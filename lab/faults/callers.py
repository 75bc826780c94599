"""Callers that write at full rate, each with views of its own, and know what was acknowledged to them."""

import threading
from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import httpx
import numpy as np

from lab.faults.drawn import TYPE, digest, image
from lab.faults.ledger import Attributes, Known, Violation, draw_attributes, draw_patch, require
from lab.faults.process import client

SHARED = "shared"
MOST = 20
"""Views that a caller keeps; then it deletes more than it enrols."""

APART = 10_000_000
"""Images of one caller: numbers from its own times this."""


@dataclass(frozen=True)
class Unanswered:
    """A call that a kill cut off: it was done, wholly, or it was not.

    Parameters
    ----------
    kind : {'enroll', 'patch', 'delete'}
        `delete` of one view, of those of a place, or of a map.
    map : str
    numbers : tuple of int
        Images of an enrolment; each may be there or not.
    attributes : Attributes
        Of the images, or of the view after a patch.
    views : tuple of Known
        That were to be changed or deleted: all of them were, or none.
    """

    kind: str
    map: str
    numbers: tuple[int, ...] = ()
    attributes: Attributes = field(default_factory=Attributes)
    views: tuple[Known, ...] = ()


class Caller:
    """One client of the service, in a thread of its own.

    Parameters
    ----------
    number : int
        From 1; its images and its own map are named by it.
    seed : int
    worker_apart : bool
        Whether the worker is a process of its own, which may be gone: then an image may be refused for want of one.
    """

    def __init__(self, number: int, seed: int, *, worker_apart: bool = False) -> None:
        self.number, self.own = number, f"own-{number}"
        self._refusals = (207, 503) if worker_apart else ()
        self.chance = np.random.default_rng([seed, number])
        self.counts: Counter[str] = Counter()
        self.views: dict[str, Known] = {}
        self.deleted: list[str] = []
        self.touched: list[str] = []
        self.unanswered: Unanswered | None = None
        self.violations: list[str] = []
        self._images = 0

    def work(self, url: str, until: threading.Event) -> None:
        """Call after call, until the service is gone or `until` is set; what went wrong is kept in `violations`."""
        with client(url) as calls:
            self.work_with(calls, until)

    def work_with(self, calls: httpx.Client, until: threading.Event | None = None) -> None:
        """The same on a connection that there is."""
        while until is None or not until.is_set():
            try:
                self._call(calls)
            except httpx.TransportError:
                return  # what was under way is kept as `unanswered`
            except Violation as error:
                self.violations.append(f"caller {self.number}: {error}")
                return

    def _call(self, calls: httpx.Client) -> None:
        kind = float(self.chance.random())
        full = len(self.views) / MOST
        views = list(self.views.values())
        one = views[int(self.chance.integers(len(views)))] if views else None
        if one is None or kind < 0.55 * (1.2 - full):
            self._enroll(calls)
        elif kind < 0.70:
            self._query(calls, one)
        elif kind < 0.82:
            self._patch(calls, one)
        elif kind < 0.97:
            self._delete(calls, "DELETE", f"/views/{one.id}", [one])
        elif kind < 0.99:
            place = one.attributes.place
            # The own map alone: a place of the shared one may be another caller's too.
            gone = [view for view in views if view.map == self.own and view.attributes.place == place]
            if place is not None and gone:
                self._delete(calls, "DELETE", "/views", gone, params={"map": self.own, "place": place})
        elif gone := [view for view in views if view.map == self.own]:
            self._delete(calls, "DELETE", f"/maps/{self.own}", gone)

    def _sent(self, answer: httpx.Response, *expected: int) -> Any:
        require(answer.status_code in expected, f"{answer.request.method} {answer.request.url.path} answered "
                f"{answer.status_code}: {answer.text[:500]}")  # fmt: skip
        self.unanswered = None
        return answer.json()

    def _enroll(self, calls: httpx.Client) -> None:
        attributes = draw_attributes(self.chance)
        to = SHARED if self.chance.random() < 0.6 else self.own
        numbers = []
        for _ in range(1 if self.chance.random() < 0.85 else 3):
            self._images += 1
            numbers.append(self.number * APART + self._images)
        waited = bool(self.chance.random() < 0.7)
        self.unanswered = Unanswered("enroll", to, tuple(numbers), attributes)
        form = {"map": to, "wait": str(waited).lower(), **attributes.parameters()}
        files = [("image", (f"{number}.png", image(number), "image/png")) for number in numbers]
        answer = self._sent(calls.post("/enroll", data=form, files=files), 201, 202, *self._refusals)
        refused = self._refused_for_want_of_a_worker(answer, len(numbers))
        kept = [number for index, number in enumerate(numbers) if index not in refused]
        for number, one in zip(kept, answer.get("views", [answer]) if kept else [], strict=True):
            self.keep(one["view"], number, attributes)
            self.counts["enrolments"] += 1

    def _refused_for_want_of_a_worker(self, answer: dict[str, Any], count: int) -> set[int]:
        """Positions of the images, of so many, that were refused so; raises Violation for any other reason."""
        if "view" in answer:
            return set()
        problems = answer["errors"] if "views" in answer else [answer]
        for problem in problems:
            require("no worker is alive" in problem["detail"], f"an image was refused: {problem['detail']}")
        refused = {problem["index"] for problem in problems} if "views" in answer else set(range(count))
        self.counts["refused for want of a worker"] += len(refused)
        return refused

    def keep(self, view: dict[str, Any], number: int, attributes: Attributes) -> None:
        """Take a view that the service showed into the own ones; raises Violation if it is not as it was sent."""
        moment = datetime.fromisoformat(view["enrolled_at"])
        known = Known(view["id"], view["map"], number, digest(image(number)), attributes, moment)
        known.compare(view)
        self.views[known.id] = known
        self.touched.append(known.id)

    def _query(self, calls: httpx.Client, one: Known) -> None:
        given = {"map": one.map, "top": "1"}
        answer = self._sent(calls.post("/query", params=given, content=image(one.number), headers=TYPE), 200)
        found = [match["view"]["id"] for match in answer["matches"]]
        # A view that nobody waited for may still be pending.
        require(found == [one.id] or answer["pending"], f"the image of view {one.id} found {found}")
        self.counts["queries"] += 1

    def _patch(self, calls: httpx.Client, one: Known) -> None:
        body, after = draw_patch(self.chance, one.attributes)
        self.unanswered = Unanswered("patch", one.map, attributes=after, views=(one,))
        answer = self._sent(calls.patch(f"/views/{one.id}", json=body), 200)
        one.attributes = after
        one.compare(answer)
        self.touched.append(one.id)
        self.counts["patches"] += 1

    def _delete(self, calls: httpx.Client, method: str, path: str, gone: list[Known], **sent: Any) -> None:
        self.unanswered = Unanswered("delete", gone[0].map, views=tuple(gone))
        receipt = self._sent(calls.request(method, path, **sent), 200)
        require(receipt["views"] == len(gone), f"{method} {path} deleted {receipt['views']} views of {len(gone)}")
        self.forget(gone)
        self.counts["deletions"] += len(gone)

    def forget(self, gone: list[Known]) -> None:
        """Count views as deleted."""
        for view in gone:
            del self.views[view.id]
            self.deleted.append(view.id)

    def settle(self, shown: dict[str, Any]) -> None:
        """Find out what became of the call that was cut off; raises Violation if it was done by half.

        Parameters
        ----------
        shown : mapping of str to view
            All views of the service by id.
        """
        call, self.unanswered = self.unanswered, None
        if call is None:
            return
        self.counts["calls cut off"] += 1
        if call.kind == "enroll":
            by_digest = {view["image"]["sha256"]: view for view in shown.values() if view["map"] == call.map}
            for number in call.numbers:
                view = by_digest.get(digest(image(number)))
                if view is not None:
                    self.keep(view, number, call.attributes)
        elif call.kind == "delete":
            there = [view for view in call.views if view.id in shown]
            require(len(there) in (0, len(call.views)), f"{len(there)} of {len(call.views)} views were deleted")
            if not there:
                self.forget(list(call.views))
        else:
            (one,) = call.views
            require(one.id in shown, f"view {one.id} is gone, and was being patched")
            before, one.attributes = one.attributes, call.attributes
            try:
                one.compare(shown[one.id])
            except Violation:
                one.attributes = before  # then all of it is as before; `check` compares
