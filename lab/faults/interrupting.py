"""Operations that stop, kill and mislead the service."""

import threading
import time
from datetime import datetime

import httpx

from lab.faults.comparing import views_of
from lab.faults.drawn import TYPE, digest, image
from lab.faults.ledger import Attributes, Known, KnownMap, draw_attributes, draw_patch, require
from lab.faults.restoring import Restoring

YEAR_H = 365 * 24.0


class Interrupting(Restoring):
    """All operations: those of callers, restarts, kills and a clock that jumps."""

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
        of, attributes, number = self.some_map(), draw_attributes(self.chance), self._new_number()
        known = self.some_view()
        kind = int(self.chance.integers(3)) if known is not None else 0
        body, after = draw_patch(self.chance, known.attributes if known is not None else attributes)
        delay_s = float(self.chance.uniform(0, 0.015))
        self.note(f"SIGKILL {delay_s * 1000:.1f} ms into operation {kind} on image {number} or {known and known.id}")
        answers: list[httpx.Response] = []

        def call() -> None:
            client = self.served.client
            try:
                if kind == 0:
                    given = {"map": of.name, **attributes.parameters()}
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
            self._adopt(of, number, attributes, acknowledged)
        elif known is not None:
            self._see(known, after, acknowledged, deleting=kind == 2)

    def _adopt(self, of: KnownMap, number: int, attributes: Attributes, acknowledged: bool) -> None:
        """Take the view of an enrolment that was interrupted into the model, if it was kept."""
        wanted = digest(image(number))
        found = [view for view in views_of(self.served, of.name) if view["image"]["sha256"] == wanted]
        require(found or not acknowledged, f"image {number} was acknowledged and is gone")
        for view in found:
            known = Known(view["id"], of.name, number, wanted, attributes, datetime.fromisoformat(view["enrolled_at"]))
            known.compare(view)
            of.views[known.id] = known
            of.untimely |= self.served.clock_s != 0
        self.served.settle()

    def _see(self, known: Known, after: Attributes, acknowledged: bool, *, deleting: bool) -> None:
        """Find out whether a change or a deletion that was interrupted was done."""
        answer = self.served.call("GET", f"/views/{known.id}", 200, 404)
        if deleting and (acknowledged or answer.status_code == 404):
            require(answer.status_code == 404, f"the deletion of {known.id} was acknowledged, and the view is there")
            self._forget([known], {"views": 1})
            return
        require(answer.status_code == 200, f"view {known.id} is gone, which nobody deleted")
        before = known.attributes
        if not deleting:
            shown = answer.json()
            known.attributes = after
            try:
                known.compare(shown)
            except Exception:
                if acknowledged:
                    raise
                known.attributes = before
        known.compare(answer.json())

    def set_clock(self) -> None:
        """The clock jumps, back and forth: by up to a day, or to 1970 as on a board without a clock, or by decades."""
        hours = [0.0, -24.0, -1.0, -0.01, 0.01, 1.0, 24.0, -56 * YEAR_H, 30 * YEAR_H]
        self.served.set_clock(3600 * float(self.chance.choice(hours)))
        self.note(f"the clock is wrong by {self.served.clock_s:.0f} s")
        for of in self.maps.values():
            of.untimely = True
