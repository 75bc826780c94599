"""Queries to a map that changes while it is queried."""

from tests.golden.adapter import Answer, Evidence, MapOptions, Query
from tests.golden.gallery import Gallery, condensed
from tests.golden.images import image
from tests.golden.maps import BUSY

FETCHES = ("half_resolution", "full_resolution", "local_features", "views")
"""Stages that ask for views that were found: one may be deleted by then."""

BEFORE_FETCHES = ("search", "catch_up")
"""Stages before: the map may have changed over to another recipe since the query was described."""

ROUNDS = 5
"""How often a query is searched at most when each time a view is gone."""

DOOMED = ("strip 3", "strip 0", "strip 5", "strip 2", "strip 6", "strip 4")
"""Views in the order in which they are deleted; never the one that is looked for."""

QUERY = Query(image("strip 1, cut"), top=7)

OTHER = MapOptions(numbers={"min_region_cells": 60})
"""Another way of describing: graphs with fewer nodes."""


def deleted_meanwhile(gallery: Gallery, stage: str, times: int) -> tuple[Answer, Answer, int]:
    """A view is deleted each of the first `times` that a stage is reached; also the answer of the calm after it, and
    how often the stage was reached."""
    service, called = gallery.fresh(BUSY)
    doomed = iter(DOOMED)
    with service.interrupted(stage, lambda: service.delete(called, next(doomed)), times) as calls:
        answer = service.query(called, QUERY)
    return answer, service.query(called, QUERY), len(calls)


def without(gallery: Gallery, deleted: int) -> Evidence:
    """What is golden of the answer when so many views were deleted before."""
    service, called = gallery.fresh(BUSY)
    for view in DOOMED[:deleted]:
        service.delete(called, view)
    return condensed(service.query(called, QUERY).evidence)


def changed_over_meanwhile(gallery: Gallery, stage: str) -> tuple[Answer, Answer, Answer]:
    """The map changes over to OTHER when a stage is first reached; also the answers before and after."""
    service, called = gallery.fresh(BUSY)
    before = service.query(gallery.map("busy, at rest")[1], QUERY)  # another map: a query brings the index up to date
    with service.interrupted(stage, lambda: service.change_recipe(called, OTHER)):
        answer = service.query(called, QUERY)
    return answer, before, service.query(called, QUERY)
