"""Turns a report of a map's health into its model on the wire."""

from app.http.presenters import position
from schemas import wire
from schemas.health import CODES, Code, HealthReport


def map_health(report: HealthReport, code: Code | None, limit: int) -> wire.MapHealth:
    """The report with at most `limit` findings of each kind, or of the kind `code` alone."""
    of = {kind: [one for one in report.findings if one.code == kind] for kind in CODES if code in (None, kind)}
    return wire.MapHealth(
        map=report.map,
        revision=report.revision,
        views=report.views,
        examined=report.examined,
        compared=report.compared,
        counts={kind: len(found) for kind, found in of.items()},
        findings=[
            wire.HealthFinding(
                code=one.code,
                detail=one.detail,
                remedy=one.remedy,
                places=list(one.places),
                views=list(one.views),
                count=one.count,
                position=None if one.position is None else position(one.position),
                headings=list(one.headings),
            )
            for found in of.values()
            for one in found[:limit]
        ],
    )
