"""How long the stages of a search take."""

import time

from worker.method import cascade
from worker.method.evidence import Evidence


class Stopwatch:
    """Times the stages of a search: ``search`` ends with the histograms, ``rerank`` with the full cells."""

    def __init__(self, observe: cascade.Observe) -> None:
        self._observe = observe
        self._ends = {"began": time.perf_counter()}

    def observe(self, stage: str, evidence: Evidence) -> None:
        """Note the end of a stage."""
        self._ends[stage] = time.perf_counter()
        self._observe(stage, evidence)

    def timing_ms(self) -> dict[str, float]:
        """Milliseconds of each stage."""
        ends = self._ends
        searched = ends["histograms"]
        compared = ends.get("full", searched)
        return {
            "search": (searched - ends["began"]) * 1000,
            "rerank": (compared - searched) * 1000,
            "verify": (time.perf_counter() - compared) * 1000,
        }
