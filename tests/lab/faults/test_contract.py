"""What the service answers is what its OpenAPI document promises; and a broken promise is noticed."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from lab.faults.contract import try_contract
from lab.faults.live_service import LiveService

SEED = 20_261_123
EXAMPLES = 8


@pytest.fixture
def served(tmp_path: Path) -> Iterator[LiveService]:
    served = LiveService(tmp_path, Counter())
    yield served
    served.close()


def test_every_answer_is_what_the_document_promises(served: LiveService) -> None:
    """`python -m lab.faults.contract --examples 1000` is the long run."""
    counts: Counter[str] = Counter()
    wrong: list[str] = []

    try_contract(served, served.json("/openapi.json"), SEED, EXAMPLES, counts, lambda _, text: wrong.append(text))

    assert not wrong, "\n\n".join(wrong)
    # Both kinds of calls come through: those that are done, and those that are refused.
    assert min(counts["answered 200"], counts["answered 201"], counts["answered 422"]) > 0, counts


def test_a_promise_that_is_not_kept_is_reported(served: LiveService) -> None:
    document = served.json("/openapi.json")
    document["paths"] = {"/version": document["paths"]["/version"]}
    document["components"]["schemas"]["Version"]["properties"]["python"] = {"type": "integer"}
    wrong: list[str] = []

    try_contract(served, document, SEED, 2, Counter(), lambda operation, text: wrong.append(operation + text))

    assert len(wrong) == 1
    assert "GET /version" in wrong[0]
