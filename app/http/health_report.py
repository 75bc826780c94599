"""Turns a map's health and its unknown places into their models on the wire."""

from dataclasses import asdict

from app.http.presenters import position
from schemas import wire
from schemas.health import CODES, Code, HealthReport
from schemas.inbox import Inbox, Proposals

SHOWN = 20
"""Queries of an unknown place that are listed at most."""


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
                scores=None if one.scores is None else wire.ScoreFall(**asdict(one.scores)),
                proposal=one.proposal,
            )
            for found in of.values()
            for one in found[:limit]
        ],
    )


def unknown_places(name: str, inbox: Inbox, limit: int) -> wire.UnknownPlaces:
    """The unknown places of a map, at most `limit`."""
    return wire.UnknownPlaces(
        map=name,
        keep_queries=inbox.keep_queries,
        kept=inbox.kept,
        examined=inbox.examined,
        count=len(inbox.places),
        places=[
            wire.UnknownPlace(
                id=place.queries[0],
                count=len(place.queries),
                queries=list(place.queries[:SHOWN]),
                first_at=place.first_at,
                last_at=place.last_at,
                links={"image": f"/maps/{name}/unknown/{place.queries[0]}/image"},
            )
            for place in inbox.places[:limit]
        ],
    )


def proposals(name: str, found: Proposals, limit: int) -> wire.Proposals:
    """The proposals of a map, at most `limit`."""
    return wire.Proposals(
        map=name,
        keep_matches=found.keep_matches,
        kept=found.kept,
        examined=found.examined,
        count=len(found.proposals),
        proposals=[
            wire.Proposal(
                id=one.queries[0],
                place=one.place,
                view=one.matched[one.queries[-1]],
                count=len(one.queries),
                confirmed=len(one.confirmed),
                queries=list(one.queries[:SHOWN]),
                lowest_score=one.lowest_score,
                highest_score=one.highest_score,
                first_at=one.first_at,
                last_at=one.last_at,
                links={
                    "image": f"/maps/{name}/proposals/{one.queries[0]}/image",
                    "view": f"/views/{one.matched[one.queries[-1]]}",
                },
            )
            for one in found.proposals[:limit]
        ],
    )
