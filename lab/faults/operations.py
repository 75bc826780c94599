"""What callers do to a service besides enrolling, each operation done to its model as well."""

from typing import Any

from lab.faults.comparing import compare_images, compare_lists, compare_map, views_of
from lab.faults.drawn import TYPE, image
from lab.faults.enrolling import NEVER_ENROLLED, Enrolling
from lab.faults.ledger import Known, KnownMap, draw_filter, draw_patch, require


class Operations(Enrolling):
    """Operations that query, change, delete and list."""

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

    def enroll_and_query(self) -> None:
        """A view that was acknowledged is found by the next query."""
        self._query_own(self._enroll_one())

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

    def query_unknown(self) -> None:
        """An image of no view; the answer is as good as any, and the same when asked again."""
        of, number = self.some_map(), NEVER_ENROLLED + int(self.chance.integers(1000))
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
        body, attributes = draw_patch(self.chance, known.attributes)
        self.note(f"PATCH /views/{known.id} {body}")
        answer = self.served.call("PATCH", f"/views/{known.id}", json=body).json()
        known.attributes = attributes
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
        self._delete_map(self.some_map())

    def _delete_map(self, of: KnownMap) -> None:
        self.note(f"DELETE /maps/{of.name}")
        self._forget(list(of.views.values()), self.served.call("DELETE", f"/maps/{of.name}").json())
        del self.maps[of.name]
        self.served.call("GET", f"/maps/{of.name}", 404)

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
