"""What callers do to a map as a whole: other rankings, other recipes, shadows; each operation done to its model too."""

import time
from typing import Any

from lab.faults.enrolling import LABELS, LIGHT
from lab.faults.ledger import KnownMap, require
from lab.faults.live_service import SETTLE_S
from lab.faults.operations import Operations


class MapChanges(Operations):
    """Operations that change rankings and recipes, while the others go on."""

    def put_map(self) -> None:
        """A map with views keeps its recipe; an empty one takes another, and has no shadow then."""
        of = self.some_map()
        self.note(f"PUT /maps/{of.name} again")
        if of.switch is not None:
            return
        body = {**LIGHT, "labels": self._labels(), "dynamic": []}
        answer = self.served.call("PUT", f"/maps/{of.name}", 200, 409, json=body)
        if answer.status_code == 200:
            facts = answer.json()
            if of.views:  # the very recipe that it has
                require(facts["recipe"]["id"] == of.recipe, f"the recipe of {of.name} was replaced under its views")
            if facts["recipe"]["id"] != of.recipe:
                of.shadow = None
            of.recipe, of.ranking = facts["recipe"]["id"], facts["ranking"]["id"]
        else:
            require(of.views, f"the empty map {of.name} refused another recipe: {answer.text}")

    def change_ranking(self) -> None:
        """Another ranking from the next query on, by the recipe to come too."""
        of = self.some_map()
        change: dict[str, Any] = {"precision": round(float(self.chance.uniform(0.8, 0.99)), 2)}
        if self.chance.random() < 0.7:
            change = {"candidates": int(self.chance.integers(2, 12)), "verified_top_k": int(self.chance.integers(0, 3))}
        self.note(f"PATCH /maps/{of.name} {change}, switch {of.switch}, shadow {of.shadow}")
        facts = self.served.call("PATCH", f"/maps/{of.name}", json={"ranking": change}).json()
        require(facts["ranking"].items() >= change.items(), f"the ranking is {facts['ranking']}")
        if of.switch is None:
            same = facts["recipe"]["id"] == of.recipe
            require(same, f"changing the ranking changed the recipe; ranking was {of.ranking}")
        if facts["recipe"]["id"] == of.recipe:
            of.ranking = facts["ranking"]["id"]

    def switch_recipe(self) -> None:
        """Another recipe, or back: described in the background, while operations go on."""
        of = self.some_map()
        self._begin_switch(of)
        if self.chance.random() < 0.5:
            self._await_switch(of)

    def cancel_switch(self) -> None:
        """A switch that is cancelled in time leaves the map as it was; one that is not is done."""
        of = self.some_map()
        if of.switch is None:
            self._begin_switch(of)
        if of.switch is None:
            return
        self.note(f"DELETE /jobs/{of.switch}, which switches {of.name}")
        answer = self.served.call("DELETE", f"/jobs/{of.switch}", 200, 409)
        if answer.status_code == 409:
            self._await_switch(of)
            return
        require(answer.json()["state"] == "cancelled", f"a job that was cancelled is {answer.json()['state']}")
        of.switch = None
        self.counts["switches cancelled"] += 1
        facts = self.served.json(f"/maps/{of.name}")
        require(facts["recipe"]["id"] == of.recipe, f"the recipe of {of.name} is {facts['recipe']['id']}")
        require(facts["ranking"]["id"] == of.ranking, f"the ranking of {of.name} is {facts['ranking']['id']}")

    def begin_shadow(self) -> None:
        """Another recipe beside that of the map, whose answers stay as they are."""
        of = self.some_map()
        self._await_switch(of)
        labels, wanted = self._labels(), int(self.chance.integers(1, 9))
        self.note(f"POST /maps/{of.name}/recipe {len(labels)} labels, shadow {wanted}")
        body = {"labels": labels, "dynamic": [], "shadow": wanted}
        answer = self.served.call("POST", f"/maps/{of.name}/recipe", 202, 409, json=body)
        if answer.status_code == 202:
            require(of.shadow is None, f"{of.name} has a second shadow")
            of.shadow = answer.json()["id"]

    def read_shadow(self) -> None:
        """A shadow is there until it is decided on; its table names no view that is not."""
        of = self.some_map()
        self.note(f"GET /maps/{of.name}/shadow")
        if of.shadow is None:
            self.served.call("GET", f"/maps/{of.name}/shadow", 404)
        else:
            self._shadow(of)

    def decide_shadow(self) -> None:
        """The map changes over to its shadow once that is ready, or keeps its recipe."""
        of = next((of for of in self.maps.values() if of.shadow is not None), None)
        if of is None:
            return
        discards = self.chance.random() < 0.4
        self.note(f"the shadow of {of.name} is {'discarded' if discards else 'awaited and switched to'}")
        if discards:
            job = self.served.call("DELETE", f"/maps/{of.name}/shadow").json()
            require(job["id"] == of.shadow, f"the shadow {job['id']} was discarded, not {of.shadow}")
        else:
            recipe = self._await_shadow(of)["recipe"]["id"]
            of.switch = self.served.call("POST", f"/maps/{of.name}/shadow/switch", 202).json()["id"]
            self._await_switch(of)
            require(of.recipe == recipe, f"{of.name} changed over to {of.recipe}, not to its shadow {recipe}")
        self.counts["shadows discarded" if discards else "shadows switched to"] += 1
        of.shadow = None
        self.served.call("GET", f"/maps/{of.name}/shadow", 404)

    def _begin_switch(self, of: KnownMap) -> None:
        self._await_switch(of)
        body = {"labels": self._labels(), "dynamic": []}
        self.note(f"POST /maps/{of.name}/recipe {len(body['labels'])} labels")
        answer = self.served.call("POST", f"/maps/{of.name}/recipe", 202, 409, json=body)
        if answer.status_code == 202:
            require(of.shadow is None, f"{of.name} has a shadow and was given another recipe")
            of.switch = answer.json()["id"]
        else:
            require("already" in answer.text or "recipe" in answer.text or of.shadow is not None, answer.text)

    def _labels(self) -> list[str]:
        return LABELS[int(self.chance.integers(len(LABELS)))]

    def _await_shadow(self, of: KnownMap) -> Any:
        """Wait until the shadow of a map is ready; returns it."""
        until = time.monotonic() + SETTLE_S
        while (shadow := self._shadow(of))["state"] != "ready":
            require(time.monotonic() < until, f"the shadow of {of.name} is still {shadow}")
            time.sleep(0.005)
        return shadow

    def _shadow(self, of: KnownMap) -> Any:
        shadow = self.served.json(f"/maps/{of.name}/shadow")
        require(shadow["job"] == of.shadow, f"the shadow of {of.name} is of the job {shadow['job']}, not {of.shadow}")
        table = shadow["table"]
        require((table is not None) == (shadow["state"] == "ready"), f"a shadow is {shadow['state']} with {table}")
        if table is not None:
            named = {row["id"] for row in table["queries"] if row["source"] == "view"}
            named |= {row[side]["view"] for row in table["queries"] for side in ("old", "new")} - {None}
            require(named <= of.views.keys(), f"a shadow's table names {named - of.views.keys()}, which are not there")
        return shadow

    def _await_switch(self, of: KnownMap) -> None:
        if of.switch is None:
            return
        state = self.served.await_job(of.switch)
        require(state == "done", f"the recipe switch of {of.name} is {state}")
        facts = self.served.json(f"/maps/{of.name}")
        of.recipe, of.ranking, of.switch = facts["recipe"]["id"], facts["ranking"]["id"], None
