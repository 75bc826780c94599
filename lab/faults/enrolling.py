"""What the operations on a service and on its model share, and those that enrol."""

from collections import Counter
from datetime import datetime
from typing import Any

import numpy as np

from lab.faults.drawn import TYPE, digest, image
from lab.faults.ledger import Attributes, Known, KnownMap, draw_attributes, require
from lab.faults.live_service import LiveService

MAPS = ("campus", "museum", "plant")
LIGHT: dict[str, Any] = {
    "parameters": {"local_features": 24},
    "ranking": {"candidates": 6, "full_resolution_top_k": 3, "detail_only_top_k": 1, "verified_top_k": 1},
}
"""A recipe and a ranking of which every stage runs and none takes long."""

LABELS = (
    ["road", "sky", "building", "vegetation"],
    ["road", "sky", "building", "vegetation", "terrain", "pole"],
)
MOST_VIEWS = 40
NEVER_ENROLLED = 10_000_000
"""Numbers of images that are never enrolled begin here."""


class Enrolling:
    """Operations that enrol, on a service and on the model of it.

    Each method is one operation; it raises Violation when the service does otherwise than the model.

    Parameters
    ----------
    served : LiveService
    chance : Generator
        Draws everything.
    counts : Counter
        What was done.
    """

    def __init__(self, served: LiveService, chance: np.random.Generator, counts: Counter[str]) -> None:
        self.served, self.chance, self.counts = served, chance, counts
        self.maps: dict[str, KnownMap] = {}
        self.deleted: list[str] = []
        self.log: list[str] = []
        self.last_clock = 0.0
        self._next = 0

    # drawing

    def note(self, text: str) -> None:
        """Remember what is being done, for the report of a violation."""
        self.log.append(text)

    def some_map(self) -> KnownMap:
        """A map; made when there is none of the drawn name."""
        name = str(self.chance.choice(MAPS))
        if name not in self.maps:
            self._put(name)
        return self.maps[name]

    def some_view(self) -> Known | None:
        """An enrolled view, or None when there is none."""
        views = [view for of in self.maps.values() for view in of.views.values()]
        return views[int(self.chance.integers(len(views)))] if views else None

    def _new_number(self) -> int:
        self._next += 1
        return self._next

    def _put(self, name: str) -> None:
        # One map as callers without wishes get it; the others are quick.
        body = {} if name == MAPS[0] and self.chance.random() < 0.2 else {**LIGHT, "labels": LABELS[0], "dynamic": []}
        self.note(f"PUT /maps/{name}")
        facts = self.served.call("PUT", f"/maps/{name}", 201, json=body).json()
        self.maps[name] = KnownMap(name, facts["recipe"]["id"], facts["ranking"]["id"], facts["revision"])

    # enrolling

    def _learn(self, answer: dict[str, Any], of: KnownMap, number: int, attributes: Attributes) -> Known:
        """Take an acknowledged enrolment into the model."""
        view = answer["view"]
        known = Known(
            view["id"], of.name, number, digest(image(number)), attributes, datetime.fromisoformat(view["enrolled_at"])
        )
        known.compare(view)
        require(view["id"] not in of.views and answer["created"], f"view {view['id']} was new and is said to be known")
        require(view["id"] not in self.deleted, f"id {view['id']} was of a deleted view")
        of.views[known.id] = known
        of.untimely |= self.served.clock_s != self.last_clock or self.served.clock_s != 0
        return known

    def enroll(self) -> None:
        """One image; its view is described when the answer comes."""
        self._enroll_one()

    def _enroll_one(self) -> Known:
        of, attributes, number = self.some_map(), draw_attributes(self.chance), self._new_number()
        self.note(f"POST /enroll image {number} in {of.name} {attributes.parameters()}")
        answer = self.served.call(
            "POST",
            "/enroll",
            201,
            params={"map": of.name, **attributes.parameters()},
            content=image(number),
            headers=TYPE,
        ).json()
        require(answer["view"]["state"] == "ready", f"201 with state {answer['view']['state']}")
        return self._learn(answer, of, number, attributes)

    def enroll_unawaited(self) -> None:
        """An image that nobody waits for: 202, and a job that ends well."""
        of, attributes, number = self.some_map(), draw_attributes(self.chance), self._new_number()
        self.note(f"POST /enroll image {number} in {of.name}, not waited for")
        parameters = {"map": of.name, "wait": "false", **attributes.parameters()}
        answer = self.served.call("POST", "/enroll", 202, params=parameters, content=image(number), headers=TYPE).json()
        self._learn(answer, of, number, attributes)
        of.jobs.append(answer["job"])

    def enroll_several(self) -> None:
        """Several images at once, one of them broken now and then."""
        of, attributes = self.some_map(), draw_attributes(self.chance)
        numbers = [self._new_number() for _ in range(int(self.chance.integers(2, 5)))]
        broken = int(self.chance.integers(len(numbers))) if self.chance.random() < 0.3 else None
        files = [
            ("image", (f"{n}.png", image(n)[:90] if i == broken else image(n), "image/png"))
            for i, n in enumerate(numbers)
        ]
        self.note(f"POST /enroll images {numbers} in {of.name}, broken: {broken}")
        form = {"map": of.name, **attributes.parameters()}
        answer = self.served.call("POST", "/enroll", 201 if broken is None else 207, data=form, files=files).json()
        sound = [n for i, n in enumerate(numbers) if i != broken]
        require(len(answer["views"]) == len(sound), f"{len(answer['views'])} of {len(sound)} sound images enrolled")
        require([e["index"] for e in answer["errors"]] == ([] if broken is None else [broken]), str(answer["errors"]))
        for number, one in zip(sound, answer["views"], strict=True):
            self._learn(one, of, number, attributes)

    def enroll_again(self) -> None:
        """The same bytes in the same map: the view that exists; with something else attributes of it: 409."""
        known = self.some_view()
        if known is None:
            return
        other = "elsewhere" if self.chance.random() < 0.4 else None
        self.note(f"POST /enroll image {known.number} in {known.map} again, place {other}")
        attributes = known.attributes.parameters() if other is None else {"place": other}
        answer = self.served.call(
            "POST",
            "/enroll",
            *([200, 202] if other is None else [409]),
            params={"map": known.map, **attributes},
            content=image(known.number),
            headers=TYPE,
        ).json()
        if other is None:
            require(not answer["created"], f"the bytes of view {known.id} made another view")
            known.compare(answer["view"])

    def enroll_with_key(self) -> None:
        """A call that is repeated with its Idempotency-Key gets the same bytes, and nothing is enrolled twice."""
        of, attributes, number = self.some_map(), draw_attributes(self.chance), self._new_number()
        self.note(f"POST /enroll image {number} in {of.name} twice with a key")
        call: dict[str, Any] = {
            "params": {"map": of.name, **attributes.parameters()},
            "content": image(number),
            "headers": {**TYPE, "idempotency-key": f"key-{number}"},
        }
        first = self.served.call("POST", "/enroll", 201, **call)
        again = self.served.call("POST", "/enroll", 201, **call)
        require(again.content == first.content, "a repeated call was answered with other bytes")
        require(again.headers.get("idempotent-replayed") == "true", "a repeated call is not marked as such")
        self._learn(first.json(), of, number, attributes)

    def refused(self) -> None:
        """A call that is refused leaves nothing behind; the comparisons would show it."""
        of, number = self.some_map(), self._new_number()
        kind = int(self.chance.integers(4))
        parameters = {"map": of.name} | ({"x": "1"} if kind == 1 else {"nonsense": "1"} if kind == 2 else {})
        data = image(number)[:100] if kind == 0 else b"GIF89a" if kind == 3 else image(number)
        self.note(f"POST /enroll refused, kind {kind}, in {of.name}")
        answer = self.served.call("POST", "/enroll", 415, 422, params=parameters, content=data, headers=TYPE)
        require(answer.headers["content-type"] == "application/problem+json", f"refused as {answer.headers}")
