"""Turns the result of a query into `schemas.wire.QueryAnswer`."""

from collections.abc import Collection, Sequence
from itertools import accumulate
from operator import itemgetter

from app.http.presenters import label_shares, position, view
from schemas import wire
from schemas.description import ContextGraph
from schemas.recipe import DescriptionRecipe
from worker.method.camera_fixed import share_left_out
from worker.method.decision import Decision, PlaceProbability
from worker.method.estimate import locate
from worker.method.evidence import GraphEvidence
from worker.method.verification import Verified
from worker.service.drives import Driven
from worker.service.explanations import point
from worker.service.query import QueryResult
from worker.service.results import RankedResults, ScoredView, SearchedMap, SearchOutcome


def query_answer(result: QueryResult) -> wire.QueryAnswer:
    """The answer to a query."""
    results, decision = result.results, result.decision
    recipe = results.recipe.description
    first = results.first_map
    results_of = {one.name: (one, found.results) for found in result.found for one in found.results.maps}
    maps = [results_of[name] for name in result.names]
    places, matches = _places(result), _matches(result)
    return wire.QueryAnswer(
        query=wire.QueryFacts(
            id=result.id,
            width=result.image.width,
            height=result.image.height,
            labels=label_shares(result.description.label_shares, recipe.labels),
            static_share=result.description.static_share,
            fixed_share=share_left_out(result.description, results.query),
        ),
        map=first.name,
        revision=first.revision,
        recipe=recipe.id,
        ranking=results.recipe.ranking.id,
        searched=sum(one.searched for one, _ in maps),
        pending=sum(one.pending for one, _ in maps),
        status=decision.status,
        confidence=decision.confidence,
        reason=_reason(result),
        places=places,
        nowhere=result.joined.nowhere,
        decision=wire.DecisionFacts(
            precision=decision.precision,
            threshold=decision.threshold,
            features=dict(decision.features),
            wrong_score=decision.levels.level,
            wrong_gap=decision.levels.gap,
            wrong_breadth=decision.levels.breadth or 0.0,
            own_score=decision.levels.own or 0.0,
            views_compared=decision.levels.compared,
        ),
        maps=[_map_answer(one, ranked, places) for one, ranked in maps] if len(maps) > 1 else None,
        drive=None if result.driven is None else _drive(result.driven, results),
        matches=matches,
        estimate=_estimate(results, decision, {match.view.id for match in matches}),
        timing_ms=dict(result.timing_ms),
    )


def _places(result: QueryResult) -> list[wire.PlaceProbability]:
    """All places, likeliest first.

    Places of one ranking stay in its order: none is sorted by a higher probability than those before it have.
    """
    places = []
    for found, part in zip(result.found, result.joined.parts, strict=True):
        bounds = accumulate((place.probability for place in part.places), min)
        places += [(-bound, _place(place, found.results)) for bound, place in zip(bounds, part.places, strict=True)]
    return [place for _, place in sorted(places, key=itemgetter(0))]


def _matches(result: QueryResult) -> list[wire.Match]:
    """The first `result.top` views, by the confidence in each."""
    views = [
        (confidence, scored, found)
        for found, part in zip(result.found, result.joined.parts, strict=True)
        for scored, confidence in zip(found.results.views, part.confidences, strict=False)
    ]
    views = sorted(views, key=lambda view: -view[0])[: result.top]
    return [
        _match(rank, scored, confidence, found, result)
        for rank, (confidence, scored, found) in enumerate(views, start=1)
    ]


def _map_answer(
    searched: SearchedMap, results: RankedResults, places: Sequence[wire.PlaceProbability]
) -> wire.MapAnswer:
    """What was searched of one of several maps, and the probability that it shows the place; `places` of all maps."""
    return wire.MapAnswer(
        map=searched.name,
        revision=searched.revision,
        recipe=results.recipe.description.id,
        ranking=results.recipe.ranking.id,
        searched=searched.searched,
        pending=searched.pending,
        probability=min(1.0, sum(place.probability for place in places if place.map == searched.name)),
    )


def _match(
    rank: int,
    scored: ScoredView,
    confidence: float,
    found: SearchOutcome,
    result: QueryResult,
) -> wire.Match:
    """A view of what a search found: that of the leading maps, or of others."""
    explains = result.explained and found is result.leading
    recipe, query_graph = found.results.recipe.description, found.description.appearance.graph
    base = f"/views/{scored.view.id}"
    explanation = (
        f"/queries/{result.id}/explanation.png?view={scored.view.id}" if explains and result.drawable else None
    )
    return wire.Match(
        rank=rank,
        view=view(scored.view, recipe.labels),
        score=scored.score,
        confidence=confidence,
        parts=dict(scored.parts),
        channels={
            name: wire.ChannelMatch(distance=distance, rank=scored.ranks[name])
            for name, distance in scored.distances.items()
        },
        dense=None if scored.dense is None else wire.DenseMatch.model_validate(scored.dense, from_attributes=True),
        graph=None if scored.graph is None else _graph(scored.graph, recipe, query_graph, explains),
        verification=None if scored.verified is None else _verification(scored.verified, explains),
        links=wire.MatchLinks(image=f"{base}/image", thumbnail=f"{base}/thumbnail", explanation=explanation),
    )


def _reason(result: QueryResult) -> wire.Reason:
    """Why the verdict is what it is; with the rival where that looks alike."""
    reason = result.decision.reason
    shown = None
    if reason.code == "look-alike" and result.rival is not None:
        rival, results = result.rival
        labels = results.recipe.description.labels
        differs = [wire.Difference.model_validate(region, from_attributes=True) for region in result.differs]
        shown = wire.Rival(
            view=view(rival.view, labels), score=rival.score, differs=differs if result.explained else None
        )
    return wire.Reason(code=reason.code, detail=reason.detail, remedy=reason.remedy, rival=shown)


def _place(place: PlaceProbability, results: RankedResults) -> wire.PlaceProbability:
    """A place with its name and position, as its best view has them."""
    scored = [results.views[i] for i in place.views]
    attributes = scored[0].view.attributes
    return wire.PlaceProbability(
        map=scored[0].view.map,
        place=attributes.place,
        position=position(attributes.position),
        probability=place.probability,
        views=[wire.ScoredId(id=one.view.id, score=one.score) for one in scored],
    )


def _drive(driven: Driven, results: RankedResults) -> wire.DriveFacts:
    """What the images of a drive say together."""
    posterior = []
    for place in driven.posterior:
        views = [results.views[i].view for i in place.views]
        shown = wire.DrivePlace(
            place=views[0].attributes.place,
            position=position(views[0].attributes.position),
            probability=min(place.probability, 1.0),
            views=[view.id for view in views],
        )
        posterior.append(shown)
    return wire.DriveFacts(
        images=driven.images,
        posterior=posterior,
        nowhere=driven.nowhere,
        single_frame_status=driven.single_status,
        agreeing=driven.agreeing,
    )


def _graph(evidence: GraphEvidence, recipe: DescriptionRecipe, query: ContextGraph, explain: bool) -> wire.GraphMatch:
    """How the context graphs of query and view agree; with `explain` also which nodes correspond."""
    pairs = None
    if explain:
        pairs = [
            wire.NodePair(
                label=recipe.labels[query.labels[p]],
                cosine=cosine,
                query=point(query.positions[p]),
                view=point(evidence.view.positions[r]),
            )
            for (p, r), cosine in zip(evidence.pairs, evidence.cosines, strict=True)
        ]
    return wire.GraphMatch(
        similarity=evidence.similarity,
        correspondences=len(evidence.pairs),
        nodes_query=len(query),
        nodes_view=len(evidence.view),
        edges_agreeing=evidence.edges_agreeing,
        pairs=pairs,
    )


def _verification(verified: Verified, explain: bool) -> wire.VerificationMatch:
    """What geometric verification found; with `explain` also where the inliers lie."""
    pairs = [(point(pair[:2]), point(pair[2:])) for pair in verified.pairs] if explain else None
    return wire.VerificationMatch(
        inliers=verified.inliers,
        matches=verified.matches,
        transform=None if verified.transform is None else verified.transform.tolist(),
        pairs=pairs,
    )


def _estimate(results: RankedResults, decision: Decision, shown: Collection[str]) -> wire.Estimate | None:
    """The estimated position of the query, from the positions of its matches, which are the views with the ids `shown`.

    None with the verdict ``no_match``, or when the best match has no position. Matches on another storey than the best
    one are left out, since nobody is between two storeys, and so are those in maps that were ranked apart, whose
    positions lie in frames of their own.
    """
    if decision.status == "no_match":
        return None
    places, best = results.ranking.places, results.views[0].seq
    matches = [i for i, scored in enumerate(results.views) if scored.view.id in shown]
    chosen = [i for i in matches if places.on_one_storey(best, results.views[i].seq)]
    views = [results.views[i].view for i in chosen]
    weights = [(decision.weights or decision.confidences)[i] for i in chosen]
    fix = locate([view.attributes.position for view in views], weights, places.positions(best))
    if fix is None:
        return None
    known = position(fix.position)
    assert known is not None, "a fix has a position"
    return wire.Estimate(position=known, radius_m=fix.radius_m, views=[views[i].id for i in fix.agreeing])
