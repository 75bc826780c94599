"""Operations that damage what the service keeps, and that take its disk away."""

import os
import sqlite3
import time
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from lab.faults.drawn import TYPE, image
from lab.faults.interrupting import Interrupting
from lab.faults.ledger import Known, require
from lab.faults.live_service import SETTLE_S
from lab.faults.small_disk import fill
from schemas.settings import Settings
from worker.storage.examining import examine
from worker.storage.repairing import repair
from worker.storage.tables import APPEARANCES, CELLS, KEYPOINTS, VECTORS

DESCRIPTIONS = (VECTORS, APPEARANCES, CELLS, KEYPOINTS)
"""Tables with a row of bytes for each view."""

ROW = "seq = (SELECT seq FROM views WHERE id = ?) AND recipe = (SELECT recipe FROM maps WHERE name = ?)"
"""Of a view, for the recipe of its map: another recipe's may have the same bytes."""


class Damaging(Interrupting):
    """All operations: those of callers, interruptions, damage, and a full disk."""

    # damage

    def damage_description(self) -> None:
        """A flipped byte in a description: nothing wrong is answered, and the view is described again."""
        known = self._quiet_view()
        if known is None:
            return
        table = DESCRIPTIONS[int(self.chance.integers(len(DESCRIPTIONS)))]
        damaged = self._flip(table, known)
        if damaged is None:
            return
        self.note(f"a byte flipped in the {table.name} of view {known.id}")
        self._query(known.number, self.maps[known.map], top="5")
        if self._body(table, known) != damaged:
            self.counts["damage found by a query"] += 1
        else:  # nothing has read that row: `doctor` does
            self._repair(table, known, damaged)
        self._await_sound(known)

    def damage_attributes(self) -> None:
        """Attributes that are damaged are never shown; enrolling the image again gives them back."""
        known = self._quiet_view()
        if known is None:
            return
        self.note(f"the place of view {known.id} is damaged")
        self._execute("UPDATE views SET place = 'hill' || coalesce(place, '') WHERE id = ?", known.id)
        self._query(known.number, self.maps[known.map], top="5")
        shown = self.served.json(f"/views/{known.id}")
        require(shown["state"] == "failed" and shown.get("place") is None, f"a damaged view is shown as {shown}")
        self._give_again(known, anew=True)

    def damage_image(self) -> None:
        """A damaged image is not served, and its view is found as before; enrolling it again mends it."""
        known = self._quiet_view()
        if known is None:
            return
        self.note(f"a byte flips in the image of view {known.id}")
        [file] = (self.served.data / "pictures").rglob(f"{known.digest}*")
        file.write_bytes(_flipped(self.chance, file.read_bytes()))
        answer = self.served.call("GET", f"/views/{known.id}/image", 500).json()
        require(answer["type"].endswith(":damaged"), f"a damaged image is answered with {answer}")
        self._query_own(known)
        self._give_again(known)
        self.read()

    def _quiet_view(self) -> Known | None:
        """A view that is described, while nothing is being written and no recipe is being switched."""
        for of in self.maps.values():
            self._await_jobs(of)
            self._await_switch(of)
        self.served.settle()
        return self.some_view()

    def _flip(self, table: sa.Table, known: Known) -> bytes | None:
        """Flip a bit of a row for the recipe of its map; what lies there now; None where nothing did, as without
        keypoints."""
        body = self._body(table, known)
        if not body:
            return None
        damaged = _flipped(self.chance, body)
        self._execute(f"UPDATE {table.name} SET body = ? WHERE {ROW}", damaged, known.id, known.map)
        return damaged

    def _body(self, table: sa.Table, known: Known) -> bytes | None:
        """What lies in the row of a view for the recipe of its map."""
        rows = self._execute(f"SELECT body FROM {table.name} WHERE {ROW}", known.id, known.map)
        return bytes(rows[0][0]) if rows else None

    def _execute(self, statement: str, *values: object) -> list[Any]:
        """Read or change the database behind the service's back."""
        with closing(sqlite3.connect(self.served.data / "revisit.db", timeout=30)) as connection, connection:
            return connection.execute(statement, values).fetchall()

    def _repair(self, table: sa.Table, known: Known, damaged: bytes) -> None:
        """What an operator does: stop, `doctor --repair`, start."""
        self.served.stop()
        if self._body(table, known) != damaged:  # views are compared in the background, which reads them too
            self.counts["damage found in the background"] += 1
            self.served.start()
            return
        data = self.served.data
        url = Settings(data=data).database_url
        found = [str(finding) for finding in examine(url, data)]
        require(any(known.id in finding for finding in found), f"doctor says nothing of view {known.id}: {found}")
        require(all(known.id in finding for finding in found), f"doctor says more than what was damaged: {found}")
        repair(url, data)
        self.counts["damage mended by doctor"] += 1
        self.served.start()

    def _give_again(self, known: Known, *, anew: bool = False) -> None:
        """Enrol the image of a damaged view again, with what was known of it; `anew`: now is when it was enrolled."""
        given = {"map": known.map, **known.attributes.parameters()}
        answer = self.served.call(
            "POST", "/enroll", 200, 202, params=given, content=image(known.number), headers=TYPE
        ).json()
        require(answer["view"]["id"] == known.id, f"view {known.id} became view {answer['view']['id']}")
        if anew:
            known.enrolled_at = datetime.fromisoformat(answer["view"]["enrolled_at"])
            self.maps[known.map].untimely = True  # `exclude_last` goes on counting from the first time
        self._await_sound(known)

    def _await_sound(self, known: Known) -> None:
        """Wait until a view is as it was, and found."""
        until = time.monotonic() + SETTLE_S
        while (shown := self.served.json(f"/views/{known.id}"))["state"] != "ready":
            require(time.monotonic() < until, f"a damaged view is still {shown}")
            time.sleep(0.005)
        known.compare(shown)
        self._query_own(known)

    # a full disk

    def fill_disk(self) -> None:
        """Another program fills the disk: images are refused, queries and deletions work, and all recovers by itself.

        With a start in between now and then, and a view that was accepted just before.
        """
        known, of = self._quiet_view(), self.some_map()
        restarts = self.chance.random() < 0.3
        if self.chance.random() < 0.5:
            self.enroll_unawaited()
        self.note(f"the disk is full, restarts: {restarts}")
        hog = fill(self.served.data)
        try:
            if restarts:
                self.served.kill()
                self.served.start()
            answer = self.served.call(
                "POST", "/enroll", 507, params={"map": of.name}, content=image(self._new_number()), headers=TYPE
            ).json()
            require(answer["type"].endswith(":disk-full"), f"a full disk is answered with {answer}")
            if known is not None:
                self._query_own(known)
            self.delete()
        finally:
            hog.unlink()
        self._await_ready()
        self.enroll()

    def _await_ready(self) -> None:
        """Wait until the service says that it is ready, by a check that began after this call."""
        began = time.monotonic()
        while True:
            ready = self.served.call("GET", "/readyz", 200, 503).json()
            lasts = time.monotonic() - began
            if ready["ready"] and ready["age_s"] < lasts - 0.1:  # rounded to a tenth
                return
            require(lasts < SETTLE_S, f"the disk has room again, and still: {ready}")
            time.sleep(0.05)


def _flipped(chance: np.random.Generator, body: bytes) -> bytes:
    changed = bytearray(body)
    changed[int(chance.integers(len(changed)))] ^= 1 << int(chance.integers(8))
    return bytes(changed)


def has_own_disk(data: Path) -> bool:
    """Whether a data folder is a file system of its own, which may be filled."""
    return os.path.ismount(data)
