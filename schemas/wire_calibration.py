"""Models of the answer to a calibration over HTTP."""

from pydantic import Field

from .wire_views import Answer


class MeasuredRate(Answer):
    """A rate that was counted, with the interval that it lies in with 95 % certainty if answers are independent."""

    value: float | None = Field(description="null when there was nothing to count.")
    interval: tuple[float, float] = Field(description="Lowest and highest (Wilson).")
    count: int
    of: int


class HeldOutFigures(Answer):
    """How a calibration did on queries that it was not fitted to."""

    log_loss: float = Field(description="Mean negative natural logarithm of the probability of what came true.")
    expected_error: float = Field(description="Expected calibration error of the confidences, ten bins.")
    precision: MeasuredRate = Field(description="Right ones among the matched answers.")
    matched_share: MeasuredRate = Field(description="Matched ones among the right answers.")
    false_accepts_per_1000: MeasuredRate = Field(
        description="Matched answers per 1,000 queries whose place the map lacks."
    )


class PrecisionThreshold(Answer):
    """The confidence from which an answer is matched when this precision is wanted."""

    precision: float
    threshold: float = Field(description="1 where no threshold keeps the precision.")
    matched_share: float = Field(description="Held-out share of the right answers that are matched.")


class CalibrationReport(Answer):
    """What came of labelled queries: the shipped and the map's own calibration, both judged on held-out queries."""

    map: str
    revision: int = Field(description="Of the map afterwards.")
    kept: bool = Field(description="Whether the map decides by its own calibration because of this call.")
    transfers: bool = Field(
        description="Whether what was learned from some of the queries helps with the others: the held-out log loss "
        "is not worse than the shipped calibration's. If not, nothing is kept."
    )
    detail: str = Field(description="The same in words.")
    queries: int = Field(description="Labelled queries with an answer.")
    unanswered: int = Field(description="Queries without any match, which were left out.")
    right: int
    unknown: int = Field(description="Queries whose place the map lacks.")
    blocks: int = Field(description="Runs of queries that were held out together.")
    folds: int
    precision: float = Field(description="Of the map: where precision, share and false accepts were judged.")
    shipped: HeldOutFigures
    own: HeldOutFigures
    thresholds: list[PrecisionThreshold] = Field(description="Of the own calibration.")
