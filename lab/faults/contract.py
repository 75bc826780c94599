"""``python -m lab.faults.contract``: the promises of the OpenAPI document, tried with data of all kinds.

Schemathesis draws the calls from the document that the service itself serves, and judges every answer: no 5xx, a
declared status, content type, headers and schema, and a refusal of what does not fit.
"""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any
from unittest import SkipTest

import numpy as np
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings, strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.core.result import Err
from schemathesis.generation.modes import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from lab.faults.drawn import TYPE, image
from lab.faults.enrolling import LABELS, LIGHT
from lab.faults.live_service import LiveService, timed_service
from lab.faults.run import Tally, parser, seed_of

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    negative_data_rejection,
]

KNOWN_SHARE = 0.6
"""Share of the calls about a view, a map, a job or a query that name one that exists."""

KEPT_SHARE = 0.15
"""Share of the optional parameters that is sent."""

_PLAIN = settings(
    deadline=None,
    database=None,
    phases=[Phase.explicit, Phase.generate],  # a failure is kept and not shrunk: the state of the service has moved on
    suppress_health_check=list(HealthCheck),
)


def sent_images() -> st.SearchStrategy[bytes]:
    """What callers send as images: mostly drawn ones, some broken, some anything."""
    sound = st.integers(0, 30).map(image)
    broken = st.builds(lambda data, keep: data[: int(len(data) * keep)], sound, st.floats(0, 0.99))
    return st.one_of(sound, sound, sound, broken, st.binary(max_size=200))


def register() -> None:
    """Teach Schemathesis what an image is; for the whole process."""
    schemathesis.openapi.format("binary", sent_images())
    for media_type in ("image/png", "image/jpeg", "image/webp", "image/bmp", "image/tiff", "application/octet-stream"):
        schemathesis.openapi.media_type(media_type, sent_images())


class Known:
    """Names and ids that exist, renewed before each operation, so that its calls reach more than a 404.

    Parameters
    ----------
    served : LiveService
    chance : Generator
    """

    def __init__(self, served: LiveService, chance: np.random.Generator) -> None:
        self._served, self._chance = served, chance
        self.names: dict[str, list[str]] = {}

    def renew(self) -> None:
        """Enrol what an earlier operation may have deleted, and look up what there is."""
        client = self._served.client
        body = {**LIGHT, "labels": LABELS[0], "dynamic": []}
        for name in ("default", "campus"):
            client.put(f"/maps/{name}", json=body)
            for number in range(3):
                attributes = {"map": name, "place": "gate", "x": str(number), "y": "1"}
                client.post("/enroll", params=attributes, content=image(number), headers=TYPE)
        views = [view["id"] for view in client.get("/views").json()["views"]]
        jobs = [job["id"] for job in client.get("/jobs").json()["jobs"]]
        given_ = {"map": "campus", "explain": "true"}
        query = client.post("/query", params=given_, content=image(1), headers=TYPE).json()["query"]["id"]
        self.names = {"view_id": views, "job_id": jobs, "map": ["default", "campus"], "query_id": [query]}

    def put_into(self, parameters: dict[str, Any] | None) -> None:
        """Replace some of the path's parameters by ones that exist."""
        for name in parameters or {}:
            if self.names.get(name) and self._chance.random() < KNOWN_SHARE:
                assert parameters is not None
                parameters[name] = str(self._chance.choice(self.names[name]))

    def thin(self, case: Any) -> None:
        """Drop most of a call's optional parameters: of a dozen at once, two always contradict each other."""
        parts = [case.query, case.body if isinstance(case.body, dict) and "image" in case.body else {}]
        for part in parts:
            for name in sorted(part or {}):
                if name not in ("image", "all") and self._chance.random() > KEPT_SHARE:
                    del part[name]
        if case.query and "map" in case.query:
            case.query["map"] = str(self._chance.choice(self.names["map"]))


def try_contract(
    served: LiveService,
    document: dict[str, Any],
    seed_: int,
    examples: int,
    counts: Counter[str],
    report: Callable[[str, str], None],
) -> None:
    """Call every operation of the document.

    Parameters
    ----------
    served : LiveService
        With an empty data folder.
    document : dict
        The service's OpenAPI document.
    seed_ : int
    examples : int
        Calls of each operation, with data that fits the document and as many with data that does not.
    counts : Counter
        Gets the calls by their statuses.
    report : function
        Called with the operation and what is wrong with an answer, once for each kind.
    """
    register()
    known = Known(served, np.random.default_rng(seed_))
    schema = schemathesis.openapi.from_dict(document)
    schema.config.update(base_url=served.running.url)
    seen: set[tuple[str, str]] = set()
    for found in schema.get_all_operations():
        if isinstance(found, Err):
            report("the document", str(found.err()))
            continue
        operation = found.ok()
        counts["operations"] += 1
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            known.renew()

            def judge(case: Any, fits: bool, label: str) -> None:
                if fits:
                    known.put_into(case.path_parameters)
                    known.thin(case)
                answer = case.call()
                counts["calls"] += 1
                counts[f"answered {answer.status_code}"] += 1
                for failure in failures(case, answer):
                    kind = (label, f"{failure.title} {answer.status_code}")
                    if kind not in seen:
                        seen.add(kind)
                        report(label, f"{failure}\n{case.as_curl_command()[:1500]}\n{answer.text[:800]}")

            _draw(operation, mode, seed_, examples, judge, counts)


def failures(case: Any, answer: Any) -> list[Failure]:
    """What is wrong with an answer."""
    try:
        case.validate_response(answer, checks=CHECKS)
    except FailureGroup as error:
        return [one for one in error.exceptions if isinstance(one, Failure)]
    except Failure as error:
        return [error]
    return []


def _draw(
    operation: Any,
    mode: GenerationMode,
    seed_: int,
    examples: int,
    judge: Callable[[Any, bool, str], None],
    counts: Counter[str],
) -> None:
    """Hand so many drawn calls of an operation to `judge`."""

    @seed(seed_)
    @settings(_PLAIN, max_examples=examples)
    @given(case=operation.as_strategy(generation_mode=mode))
    def call(case: Any) -> None:
        judge(case, mode.is_positive, operation.label)

    try:
        call()
    except (Unsatisfiable, SkipTest):
        # There is no such data, as there is no wrong data for an operation without parameters.
        counts["operations without such data"] += 1
    except ValueError as error:
        if "Unsupported type: 'Binary'" not in str(error):  # Schemathesis held bytes of its own against a schema
            raise
        counts["operations whose data ended early"] += 1


def main(argv: Sequence[str] | None = None) -> int:
    """Try the contract; returns 1 after any violation."""
    options = parser("What the OpenAPI document promises, tried with data that fits it and data that does not.")
    options.add_argument("--examples", type=int, default=300, help="calls of each operation and kind (default: 300)")
    arguments = options.parse_args(argv)
    tally = Tally("contract", seed_of(arguments))

    def report(operation: str, text: str) -> None:
        tally.violations.append(f"{operation}: {text}")
        print(f"VIOLATION: {operation}: {text}", file=sys.stderr, flush=True)

    with timed_service(tally, arguments.folder) as served:
        try_contract(served, served.json("/openapi.json"), tally.seed, arguments.examples, tally.counts, report)
    return tally.finish()


if __name__ == "__main__":
    sys.exit(main())
