"""Queries to a map that changes while it is queried."""

from tests.golden.adapter import Answer, Evidence, MapOptions, Query
from tests.golden.gallery import Gallery, condensed
from tests.golden.images import image
from tests.golden.maps import BUSY

FETCHES = ("half_resolution", "full_resolution", "local_features", "views")
"""Stages that fetch views of the candidates, one of which may be deleted by then."""

BEFORE_FETCHES = ("search", "catch_up")
"""Earlier stages: the map may have switched to another recipe since the query was described."""

ROUNDS = 5
"""Most searches of one query when a view is gone each time."""

DOOMED = ("strip 3", "strip 0", "strip 5", "strip 2", "strip 6", "strip 4")
"""Views in the order of their deletion; never the right answer."""

QUERY = Query(image("strip 1, cut"), top=7)

OTHER = MapOptions(numbers={"min_region_cells": 60})
"""Another recipe: graphs with fewer nodes."""

FEWER_LABELS = MapOptions(labels=["sky", "building", "road", "other"], dynamic=[])
"""Another recipe: shares of fewer labels."""


def deleted_meanwhile(gallery: Gallery, stage: str, times: int) -> tuple[Answer, Answer, int]:
    """Query while a view is deleted at each of the first `times` calls of a stage.

    Returns that answer, the answer to the same query afterwards, and the number of calls of the stage.
    """
    service, called = gallery.fresh(BUSY)
    doomed = iter(DOOMED)
    with service.interrupted(stage, lambda: service.delete(called, next(doomed)), times) as calls:
        answer = service.query(called, QUERY)
    return answer, service.query(called, QUERY), len(calls)


def without(gallery: Gallery, deleted: int) -> Evidence:
    """The condensed answer when `deleted` views were deleted before the query."""
    service, called = gallery.fresh(BUSY)
    for view in DOOMED[:deleted]:
        service.delete(called, view)
    return condensed(service.query(called, QUERY).evidence)


def changed_over_meanwhile(gallery: Gallery, stage: str, options: MapOptions) -> tuple[Answer, Answer, Answer]:
    """Query while the map switches to other options at the first call of a stage; the answers then, before, after."""
    service, called = gallery.fresh(BUSY)
    before = service.query(gallery.map("busy, at rest")[1], QUERY)  # another map: a query brings the index up to date
    service.forget_index(called)
    with service.interrupted(stage, lambda: service.change_recipe(called, options)):
        answer = service.query(called, QUERY)
    return answer, before, service.query(called, QUERY)
