"""Services with maps that are made when first needed, and the golden runs on them."""

import hashlib
import json
import re
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from tests.golden.adapter import EncoderName, Evidence, Service
from tests.golden.cases import CASES
from tests.golden.images import image
from tests.golden.maps import MAPS, Map

PAIRS = 3
"""Pairs of the best match that are kept as they are."""

LABELS = ("query.labels", "query.label_shares")
FIRST_LABELS = 3
"""Labels of a query that are kept with their shares; of all labels, a digest."""

NUMBERS = 6
"""Leading numbers of an array that are kept."""

DIGITS = 16
"""Hexadecimal digits of a SHA-256 that are kept."""


class Gallery:
    """Services, one for each encoder, started when first needed.

    Parameters
    ----------
    folder : Path
        Data folders of the services.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._services: dict[EncoderName, Service] = {}
        self._made: dict[str, Evidence] = {}
        self._described: dict[tuple[str, str], Evidence] = {}
        self._numbers = count()
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def service(self, encoder: EncoderName) -> Service:
        """The service with an encoder."""
        if encoder not in self._services:
            self._services[encoder] = self._open.enter_context(Service(self._folder / encoder, encoder))
        return self._services[encoder]

    def map(self, name: str) -> tuple[Service, str, Evidence]:
        """One of MAPS: its service, its name there, and the facts of the map and its views."""
        wanted = MAPS[name]
        service, called = self.service(wanted.encoder), re.sub(r"[^a-z0-9]+", "-", name)
        if name not in self._made:
            made = {"map": service.make_map(called, wanted.options)}
            self._made[name] = made | {
                enrolled.image: service.enroll(called, enrolled.view()) for enrolled in wanted.views
            }
        return service, called, self._made[name]

    def fresh(self, wanted: Map) -> tuple[Service, str]:
        """A map of its own for one test, which may change it: its service and its name."""
        service, called = self.service(wanted.encoder), f"fresh-{next(self._numbers)}"
        service.make_map(called, wanted.options)
        for enrolled in wanted.views:
            service.enroll(called, enrolled.view())
        return service, called

    def answered(self, name: str) -> Evidence:
        """The condensed answer of one of CASES."""
        service, called, _ = self.map(CASES[name].map)
        return condensed(service.query(called, CASES[name].query()).evidence)

    def described(self, map_name: str, image_name: str) -> Evidence:
        """The condensed description of an image by a map's recipe; cached."""
        if (map_name, image_name) not in self._described:
            self._described[map_name, image_name] = self.described_again(map_name, image_name)
        return self._described[map_name, image_name]

    def described_again(self, map_name: str, image_name: str) -> Evidence:
        """As `described`, but not cached."""
        service, called, _ = self.map(map_name)
        described = service.describe(called, image(image_name))
        return {name: in_short(value) if isinstance(value, np.ndarray) else value for name, value in described.items()}


def condensed(evidence: Evidence) -> Evidence:
    """Evidence with the first of the query's labels and of the best match's pairs, and digests of all of them."""
    short: Evidence = {}
    for name, column in evidence.items():
        if name.endswith(".pairs"):
            short[f"{name} of the first"] = column[0] and column[0][:PAIRS]
        elif name in LABELS:
            short[name] = column[:FIRST_LABELS]
        else:
            short[name] = column
            continue
        short[f"{name}.sha256"] = _digest(json.dumps(column).encode())
    return short


def in_short(array: Any) -> Evidence:
    """An array's type, shape, leading numbers, mean absolute number and digest."""
    return {
        "type": str(array.dtype),
        "shape": list(array.shape),
        "leading": array.ravel()[:NUMBERS].tolist(),
        "mean size": float(np.abs(array.astype(np.float64)).mean()) if array.size else None,
        "sha256": _digest(np.ascontiguousarray(array).tobytes()),
    }


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:DIGITS]
