"""What came of a calibration, as it is answered."""

from schemas import wire
from worker.method.own_calibration import HeldOut, Share
from worker.service.calibrating import CalibrationResult


def calibration_report(result: CalibrationResult) -> wire.CalibrationReport:
    """What came of a calibration."""
    fitted, labelled, calibration = result.fitted, result.labelled, result.fitted.own.calibration
    lines = zip(calibration.precisions, calibration.thresholds, calibration.shares, strict=True)
    return wire.CalibrationReport(
        map=result.record.name,
        revision=result.record.revision,
        kept=result.kept,
        transfers=fitted.transfers,
        detail=_outcome(result),
        queries=len(labelled.right),
        unanswered=result.unanswered,
        right=int(labelled.right.sum()),
        unknown=int((~labelled.known).sum()),
        blocks=fitted.blocks,
        folds=fitted.folds,
        precision=result.precision,
        shipped=_held_out(fitted.shipped_does),
        own=_held_out(fitted.own_does),
        thresholds=[
            wire.PrecisionThreshold(precision=float(wanted), threshold=float(limit), matched_share=float(share))
            for wanted, limit, share in lines
        ],
    )


def _outcome(result: CalibrationResult) -> str:
    if not result.fitted.transfers:
        return (
            "what was learned from some of these queries does not transfer to the others: the shipped calibration does "
            "better on them; nothing was changed"
        )
    if result.trial:
        return "it does better on held-out queries than the shipped calibration; as a trial, nothing was changed"
    return "it does better on held-out queries than the shipped calibration, and decides from now on"


def _held_out(figures: HeldOut) -> wire.HeldOutFigures:
    return wire.HeldOutFigures(
        log_loss=figures.log_loss,
        expected_error=figures.expected_error,
        precision=_rate(figures.precision),
        matched_share=_rate(figures.matched_share),
        false_accepts_per_1000=_rate(figures.false_accepts, 1000),
    )


def _rate(share: Share, per: float = 1.0) -> wire.MeasuredRate:
    lowest, highest = share.interval
    value = None if share.value is None else share.value * per
    return wire.MeasuredRate(value=value, interval=(lowest * per, highest * per), count=share.count, of=share.of)
