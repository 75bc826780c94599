"""What callers do to a service, one operation at a time, each done to the model as well."""

import threading
import time
from collections import Counter
from datetime import datetime
from typing import Any

import httpx
import numpy as np

from lab.faults.comparing import compare_images, compare_lists, compare_map, views_of
from lab.faults.drawn import TYPE, digest, image
from lab.faults.ledger import Known, KnownMap, Said, draw_filter, draw_patch, draw_said, require
from lab.faults.served import Served

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
STRANGERS = 10_000_000
"""Numbers of images that are never enrolled begin here."""


class Operations:
    """Operations on a service and on the model of it.

    Each method is one operation; it raises Violation when the service does otherwise than the model.

    Parameters
    ----------
    served : Served
    chance : Generator
        Draws everything.
    counts : Counter
        What was done.
    """

    def __init__(self, served: Served, chance: np.random.Generator, counts: Counter[str]) -> None:
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

    def _learn(self, answer: dict[str, Any], of: KnownMap, number: int, said: Said) -> Known:
        """Take an acknowledged enrolment into the model."""
        view = answer["view"]
        known = Known(
            view["id"], of.name, number, digest(image(number)), said, datetime.fromisoformat(view["enrolled_at"])
        )
        known.compare(view)
        require(view["id"] not in of.views and answer["created"], f"view {view['id']} was new and is said to be known")
        require(view["id"] not in self.deleted, f"id {view['id']} was of a deleted view")
        of.views[known.id] = known
        of.untimely |= self.served.clock_s != self.last_clock or self.served.clock_s != 0
        return known

    def enroll(self) -> None:
        """One image; its view can be found at once."""
        of, said, number = self.some_map(), draw_said(self.chance), self._new_number()
        self.note(f"POST /enroll image {number} in {of.name} {said.parameters()}")
        answer = self.served.call(
            "POST", "/enroll", 201, params={"map": of.name, **said.parameters()}, content=image(number), headers=TYPE
        ).json()
        require(answer["view"]["state"] == "ready", f"201 with state {answer['view']['state']}")
        known = self._learn(answer, of, number, said)
        if self.chance.random() < 0.3:
            self._query_own(known)

    def enroll_unawaited(self) -> None:
        """An image that nobody waits for: 202, and a job that ends well."""
        of, said, number = self.some_map(), draw_said(self.chance), self._new_number()
        self.note(f"POST /enroll image {number} in {of.name}, not waited for")
        parameters = {"map": of.name, "wait": "false", **said.parameters()}
        answer = self.served.call("POST", "/enroll", 202, params=parameters, content=image(number), headers=TYPE).json()
        self._learn(answer, of, number, said)
        of.jobs.append(answer["job"])

    def enroll_several(self) -> None:
        """Several images at once, one of them broken now and then."""
        of, said = self.some_map(), draw_said(self.chance)
        numbers = [self._new_number() for _ in range(int(self.chance.integers(2, 5)))]
        broken = int(self.chance.integers(len(numbers))) if self.chance.random() < 0.3 else None
        files = [
            ("image", (f"{n}.png", image(n)[:90] if i == broken else image(n), "image/png"))
            for i, n in enumerate(numbers)
        ]
        self.note(f"POST /enroll images {numbers} in {of.name}, broken: {broken}")
        form = {"map": of.name, **said.parameters()}
        answer = self.served.call("POST", "/enroll", 201 if broken is None else 207, data=form, files=files).json()
        sound = [n for i, n in enumerate(numbers) if i != broken]
        require(len(answer["views"]) == len(sound), f"{len(answer['views'])} of {len(sound)} sound images enrolled")
        require([e["index"] for e in answer["errors"]] == ([] if broken is None else [broken]), str(answer["errors"]))
        for number, one in zip(sound, answer["views"], strict=True):
            self._learn(one, of, number, said)

    def enroll_again(self) -> None:
        """The same bytes in the same map: the view that exists; with something else said of it: 409."""
        known = self.some_view()
        if known is None:
            return
        other = "elsewhere" if self.chance.random() < 0.4 else None
        self.note(f"POST /enroll image {known.number} in {known.map} again, place {other}")
        said = known.said.parameters() if other is None else {"place": other}
        answer = self.served.call(
            "POST",
            "/enroll",
            *([200, 202] if other is None else [409]),
            params={"map": known.map, **said},
            content=image(known.number),
            headers=TYPE,
        ).json()
        if other is None:
            require(not answer["created"], f"the bytes of view {known.id} made another view")
            known.compare(answer["view"])

    def enroll_with_key(self) -> None:
        """A call that is repeated with its Idempotency-Key gets the same bytes, and nothing is enrolled twice."""
        of, said, number = self.some_map(), draw_said(self.chance), self._new_number()
        self.note(f"POST /enroll image {number} in {of.name} twice with a key")
        call: dict[str, Any] = {
            "params": {"map": of.name, **said.parameters()},
            "content": image(number),
            "headers": {**TYPE, "idempotency-key": f"key-{number}"},
        }
        first = self.served.call("POST", "/enroll", 201, **call)
        again = self.served.call("POST", "/enroll", 201, **call)
        require(again.content == first.content, "a repeated call was answered with other bytes")
        require(again.headers.get("idempotent-replayed") == "true", "a repeated call is not marked as such")
        self._learn(first.json(), of, number, said)

    def refused(self) -> None:
        """A call that is refused leaves nothing behind; the comparisons would show it."""
        of, number = self.some_map(), self._new_number()
        kind = int(self.chance.integers(4))
        parameters = {"map": of.name} | ({"x": "1"} if kind == 1 else {"nonsense": "1"} if kind == 2 else {})
        data = image(number)[:100] if kind == 0 else b"GIF89a" if kind == 3 else image(number)
        self.note(f"POST /enroll refused, kind {kind}, in {of.name}")
        answer = self.served.call("POST", "/enroll", 415, 422, params=parameters, content=data, headers=TYPE)
        require(answer.headers["content-type"] == "application/problem+json", f"refused as {answer.headers}")

    # querying

    def _query(self, number: int, of: KnownMap, **parameters: str) -> Any:
        given = {"map": of.name, **parameters}
        answer = self.served.call("POST", "/query", params=given, content=image(number), headers=TYPE).json()
        require(answer["map"] == of.name, f"a query of {of.name} was answered from {answer['map']}")
        require(answer["revision"] >= of.revision, f"revision {answer['revision']} was answered after {of.revision}")
        of.revision = answer["revision"]
        if of.switch is None:
            require(answer["recipe"] == of.recipe, f"recipe {answer['recipe']} answered, not {of.recipe}")
            require(answer["ranking"] == of.ranking, f"ranking {answer['ranking']} answered, not {of.ranking}")
        shares = [place["probability"] for place in answer["places"]] + [answer["nowhere"]]
        require(abs(sum(shares) - 1) < 1e-6, f"probabilities sum to {sum(shares)}")
        for match in answer["matches"]:
            require(match["view"]["id"] in of.views, f"view {match['view']['id']} is not of this map, or was deleted")
            of.views[match["view"]["id"]].compare(match["view"])
        return answer

    def _await_jobs(self, of: KnownMap) -> None:
        for job in of.jobs:
            state = self.served.await_job(job)
            require(state in ("done", "gone"), f"job {job} is {state}")
        of.jobs.clear()

    def _query_own(self, known: Known, **parameters: str) -> None:
        answer = self._query(known.number, self.maps[known.map], top="1", **parameters)
        found = [match["view"]["id"] for match in answer["matches"]]
        require(found == [known.id], f"the image of view {known.id} found {found}")

    def query_own(self) -> None:
        """An enrolled image finds its own view."""
        known = self.some_view()
        if known is None:
            return
        of = self.maps[known.map]
        self._await_jobs(of)
        precision = round(float(self.chance.uniform(0.5, 0.999)), 3)
        self.note(f"POST /query image {known.number} of view {known.id} in {of.name}, precision {precision}")
        self._query_own(known, precision=str(precision))

    def query_filtered(self) -> None:
        """Filters are exact: as many searched as fit, no other among the matches, `top` filled."""
        of = self.some_map()
        known = self.some_view()
        if known is None:
            return
        self._await_jobs(of)
        narrowed = draw_filter(self.chance, of)
        top = int(self.chance.choice([1, 5, 100]))
        self.note(f"POST /query image {known.number} in {of.name}, {dict(narrowed.parameters)}, top {top}")
        answer = self._query(known.number, of, top=str(top), candidates="2", **narrowed.parameters)
        left = narrowed.left(list(of.views.values()))
        ids = [match["view"]["id"] for match in answer["matches"]]
        require(answer["searched"] == len(left), f"{answer['searched']} views searched, {len(left)} fit")
        require(set(ids) <= {view.id for view in left}, f"views {set(ids) - {v.id for v in left}} do not fit")
        require(len(ids) == min(top, len(left)), f"{len(ids)} matches of {len(left)} views that fit, top {top}")
        if known.id in {view.id for view in left}:
            require(ids[0] == known.id, f"the image of view {known.id} found {ids[0]} first")

    def query_stranger(self) -> None:
        """An image of no view; the answer is as good as any, and the same when asked again."""
        of, number = self.some_map(), STRANGERS + int(self.chance.integers(1000))
        self._await_jobs(of)
        self.note(f"POST /query image {number} of no view in {of.name}")
        first, second = (self._query(number, of, top="3") for _ in range(2))
        if first["revision"] == second["revision"]:
            shown = [[(m["view"]["id"], m["score"]) for m in answer["matches"]] for answer in (first, second)]
            require(shown[0] == shown[1], f"the same query at the same revision: {shown}")

    # changing and deleting

    def patch(self) -> None:
        """Attributes of a view change as the patch says."""
        known = self.some_view()
        if known is None:
            return
        body, said = draw_patch(self.chance, known.said)
        self.note(f"PATCH /views/{known.id} {body}")
        answer = self.served.call("PATCH", f"/views/{known.id}", json=body).json()
        known.said = said
        known.compare(answer)

    def delete(self) -> None:
        """A view is gone at once."""
        known = self.some_view()
        if known is None:
            return
        self.note(f"DELETE /views/{known.id}")
        receipt = self.served.call("DELETE", f"/views/{known.id}").json()
        self._forget([known], receipt)
        answer = self._query(known.number, self.maps[known.map], top="5")
        require(known.id not in {match["view"]["id"] for match in answer["matches"]}, "a deleted view was found")

    def _forget(self, gone: list[Known], receipt: dict[str, Any]) -> None:
        require(receipt["views"] == len(gone), f"{receipt['views']} views deleted, {len(gone)} fit")
        for view in gone:
            del self.maps[view.map].views[view.id]
            self.deleted.append(view.id)

    def delete_filtered(self) -> None:
        """The views that fit are gone, and no other."""
        of = self.some_map()
        narrowed = draw_filter(self.chance, of)
        wanted = dict(narrowed.parameters) or {"all": "true"}
        self.note(f"DELETE /views of {of.name}, {wanted}")
        gone = narrowed.left(list(of.views.values()))
        self._forget(gone, self.served.call("DELETE", "/views", params={"map": of.name, **wanted}).json())

    def delete_map(self) -> None:
        """A map is gone with all its views."""
        of = self.some_map()
        self.note(f"DELETE /maps/{of.name}")
        self._forget(list(of.views.values()), self.served.call("DELETE", f"/maps/{of.name}").json())
        del self.maps[of.name]
        self.served.call("GET", f"/maps/{of.name}", 404)

    def put_map(self) -> None:
        """A map with views keeps its recipe; an empty one takes another."""
        of = self.some_map()
        self.note(f"PUT /maps/{of.name} again")
        if of.switch is not None:
            return
        body = {**LIGHT, "labels": LABELS[int(self.chance.integers(2))], "dynamic": []}
        answer = self.served.call("PUT", f"/maps/{of.name}", 200, 409, json=body)
        if answer.status_code == 200:
            facts = answer.json()
            if of.views:  # the very recipe that it has
                require(facts["recipe"]["id"] == of.recipe, f"the recipe of {of.name} was replaced under its views")
            of.recipe, of.ranking = facts["recipe"]["id"], facts["ranking"]["id"]
        else:
            require(of.views, f"the empty map {of.name} refused another recipe: {answer.text}")

    def change_ranking(self) -> None:
        """Another ranking from the next query on."""
        of = self.some_map()
        self._await_switch(of)
        change = {"candidates": int(self.chance.integers(2, 12)), "verified_top_k": int(self.chance.integers(0, 3))}
        self.note(f"PATCH /maps/{of.name} {change}")
        before = of.ranking
        facts = self.served.call("PATCH", f"/maps/{of.name}", json={"ranking": change}).json()
        require(facts["ranking"].items() >= change.items(), f"the ranking is {facts['ranking']}")
        require(facts["recipe"]["id"] == of.recipe, f"changing the ranking changed the recipe; ranking was {before}")
        of.ranking = facts["ranking"]["id"]

    def switch_recipe(self) -> None:
        """Another recipe, or back: described in the background, while operations go on."""
        of = self.some_map()
        self._await_switch(of)
        body = {"labels": LABELS[int(self.chance.integers(2))], "dynamic": []}
        self.note(f"POST /maps/{of.name}/recipe {len(body['labels'])} labels")
        answer = self.served.call("POST", f"/maps/{of.name}/recipe", 202, 409, json=body)
        if answer.status_code == 202:
            of.switch = answer.json()["id"]
            if self.chance.random() < 0.5:
                self._await_switch(of)
        else:
            require("already" in answer.text or "recipe" in answer.text, answer.text)

    def _await_switch(self, of: KnownMap) -> None:
        if of.switch is None:
            return
        state = self.served.await_job(of.switch)
        require(state == "done", f"the recipe switch of {of.name} is {state}")
        facts = self.served.json(f"/maps/{of.name}")
        of.recipe, of.ranking, of.switch = facts["recipe"]["id"], facts["ranking"]["id"], None

    # reading

    def list_pages(self) -> None:
        """Pages of views, filtered or not, forwards or backwards: every view that fits, once."""
        of = self.some_map()
        narrowed = draw_filter(self.chance, of)
        page, backwards = int(self.chance.integers(1, 20)), self.chance.random() < 0.5
        self.note(f"GET /views of {of.name}, {dict(narrowed.parameters)}, {page} a page, backwards {backwards}")
        shown = views_of(self.served, of.name, page, sort="-enrolled_at" if backwards else "enrolled_at",
                         **narrowed.parameters)  # fmt: skip
        compare_lists(of.name, narrowed.left(list(of.views.values())), shown[::-1] if backwards else shown)

    def list_jobs(self) -> None:
        """Pages of jobs, newest first, each job once."""
        self.note("GET /jobs")
        ids: list[str] = []
        parameters = {"limit": "100"}
        for _ in range(3):
            page = self.served.json("/jobs", **parameters)
            ids += [job["id"] for job in page["jobs"]]
            if page["next"] is None:
                break
            parameters["cursor"] = page["next"]
        require(len(ids) == len(set(ids)), "a job is on two pages")

    def read(self) -> None:
        """A view's image and a map's facts."""
        known, of = self.some_view(), self.some_map()
        self.note(f"GET an image, GET /maps/{of.name}")
        if known is not None:
            compare_images(self.served, [known])
        compare_map(of, self.served.json(f"/maps/{of.name}"))

    # faults

    def restart(self) -> None:
        """SIGTERM and a start."""
        self.note("SIGTERM, start")
        self.served.stop()
        self.served.start()

    def kill(self) -> None:
        """SIGKILL between two calls and a start."""
        self.note("SIGKILL, start")
        self.served.kill()
        self.served.start()

    def kill_during(self) -> None:
        """SIGKILL at any moment of a call, which may have been done or not, but not by half."""
        of, said, number = self.some_map(), draw_said(self.chance), self._new_number()
        known = self.some_view()
        kind = int(self.chance.integers(3)) if known is not None else 0
        body, after = draw_patch(self.chance, known.said if known is not None else said)
        delay_s = float(self.chance.uniform(0, 0.015))
        self.note(f"SIGKILL {delay_s * 1000:.1f} ms into operation {kind} on image {number} or {known and known.id}")
        answers: list[httpx.Response] = []

        def call() -> None:
            client = self.served.client
            try:
                if kind == 0:
                    given = {"map": of.name, **said.parameters()}
                    answers.append(client.post("/enroll", params=given, content=image(number), headers=TYPE))
                elif known is not None:
                    path = f"/views/{known.id}"
                    answers.append(client.patch(path, json=body) if kind == 1 else client.delete(path))
            except (httpx.HTTPError, RuntimeError):
                pass  # no answer: the call may have been done or not

        caller = threading.Thread(target=call)
        caller.start()
        time.sleep(delay_s)
        self.served.running.kill()
        caller.join()
        self.served.kill()
        self.served.start()
        acknowledged = any(answer.status_code < 300 for answer in answers)
        self.counts[f"killed calls {'with' if acknowledged else 'without'} an answer"] += 1
        if kind == 0:
            self._adopt(of, number, said, acknowledged)
        elif known is not None:
            self._see(known, after, acknowledged, deleting=kind == 2)

    def _adopt(self, of: KnownMap, number: int, said: Said, acknowledged: bool) -> None:
        """Take the view of an enrolment that was interrupted into the model, if it was kept."""
        wanted = digest(image(number))
        found = [view for view in views_of(self.served, of.name) if view["image"]["sha256"] == wanted]
        require(found or not acknowledged, f"image {number} was acknowledged and is gone")
        for view in found:
            known = Known(view["id"], of.name, number, wanted, said, datetime.fromisoformat(view["enrolled_at"]))
            known.compare(view)
            of.views[known.id] = known
            of.untimely |= self.served.clock_s != 0
        self.served.settle()

    def _see(self, known: Known, after: Said, acknowledged: bool, *, deleting: bool) -> None:
        """Find out whether a change or a deletion that was interrupted was done."""
        answer = self.served.call("GET", f"/views/{known.id}", 200, 404)
        if deleting and (acknowledged or answer.status_code == 404):
            require(answer.status_code == 404, f"the deletion of {known.id} was acknowledged, and the view is there")
            self._forget([known], {"views": 1})
            return
        require(answer.status_code == 200, f"view {known.id} is gone, which nobody deleted")
        before = known.said
        if not deleting:
            shown = answer.json()
            known.said = after
            try:
                known.compare(shown)
            except Exception:
                if acknowledged:
                    raise
                known.said = before
        known.compare(answer.json())

    def set_clock(self) -> None:
        """The clock jumps, back and forth, by up to a day."""
        hours = [0.0, -24.0, -1.0, -0.01, 0.01, 1.0, 24.0]
        self.served.set_clock(3600 * float(self.chance.choice(hours)))
        self.note(f"the clock is wrong by {self.served.clock_s:.0f} s")
        for of in self.maps.values():
            of.untimely = True
