"""Turns the results of the use-cases into the models of `schemas.wire`."""

from collections.abc import Collection, Sequence
from dataclasses import asdict
from datetime import datetime
from itertools import accumulate
from operator import itemgetter
from typing import Literal

from schemas import wire
from schemas.description import ContextGraph, Floats
from schemas.recipe import DescriptionRecipe
from schemas.records import Failure, JobRecord, PlaceRecord, Position, ViewRecord
from worker.images.palette import colour
from worker.method.camera_fixed import share_left_out
from worker.method.decision import Decision, PlaceProbability, own_share
from worker.method.estimate import locate
from worker.method.evidence import GraphEvidence
from worker.method.verification import Verified
from worker.service.drives import Driven
from worker.service.explanations import point
from worker.service.maps import MapState
from worker.service.query import QueryResult
from worker.service.results import RankedResults, ScoredView, SearchedMap, SearchOutcome
from worker.service.views import DynamicPreview, LabelledView


def position(position: Position) -> wire.Position | None:
    """A position; None when all its fields are None."""
    if all(value is None for value in asdict(position).values()):
        return None
    return wire.Position(**asdict(position))


def label_shares(shares: Floats, labels: Sequence[str]) -> list[wire.LabelShare]:
    """Labels with a share above 0, largest first; `shares` is (n_labels,), 0 to 1."""
    present = [wire.LabelShare(label=w, share=float(s)) for w, s in zip(labels, shares, strict=True) if s > 0]
    return sorted(present, key=lambda entry: -entry.share)


def view(record: ViewRecord, labels: Sequence[str]) -> wire.View:
    """A view; `labels` are those of the recipe that it is described by."""
    description = record.description
    base = f"/views/{record.id}"
    return wire.View(
        id=record.id,
        map=record.map,
        place=record.attributes.place,
        position=position(record.attributes.position),
        captured_at=record.attributes.captured_at,
        enrolled_at=record.enrolled_at,
        metadata=dict(record.attributes.metadata),
        filename=record.attributes.filename,
        image=wire.ImageFacts.model_validate(
            {
                "width": record.image.width,
                "height": record.image.height,
                "bytes": record.image.byte_count,
                "format": record.image.format,
                "sha256": record.image.sha256,
            }
        ),
        state=record.state,
        failure=failure(record.failure),
        description=None
        if description is None
        else wire.DescriptionFacts(
            recipe=description.recipe,
            sampled_descriptors=description.descriptor_count,
            static_share=description.static_share,
            labels=label_shares(description.label_shares, labels),
            nodes=description.nodes,
        ),
        links=wire.ViewLinks(
            self=base,
            image=f"{base}/image",
            thumbnail=f"{base}/thumbnail",
            segmentation=f"{base}/segmentation.png",
            graph=f"{base}/graph.png",
        ),
    )


def failure(reason: Failure | None) -> wire.Failure | None:
    """Why a view or a job failed."""
    return None if reason is None else wire.Failure(code=reason.code, detail=reason.detail)


def job(record: JobRecord) -> wire.Job:
    """A job."""
    links = {"self": f"/jobs/{record.id}", "map": f"/maps/{record.map}"}
    if record.view_id is not None:
        links["view"] = f"/views/{record.view_id}"
    progress = record.progress
    return wire.Job(
        id=record.id,
        kind=record.kind,
        state=record.state,
        map=record.map,
        view=record.view_id,
        attempts=record.attempts,
        progress=None if progress is None else wire.JobProgress(done=progress.done, total=progress.total),
        result=None if record.result is None else dict(record.result),
        created_at=record.created_at,
        finished_at=record.finished_at,
        failure=failure(record.failure),
        links=links,
    )


def map_facts(state: MapState) -> wire.MapFacts:
    """A map: counts, both halves of its recipe, labels, vocabulary, extent."""
    record, counts = state.record, state.counts
    recipe, ranking = record.description, record.ranking
    lowest, highest = position(counts.lowest), position(counts.highest)
    channels = recipe.parameters.channels.items()
    return wire.MapFacts(
        name=record.name,
        revision=record.revision,
        views={"pending": 0, "ready": 0, "failed": 0, **counts.views},
        places=counts.places,
        bytes=counts.image_bytes,
        recipe={"id": recipe.id, **recipe.model_dump(mode="json")},
        ranking={"id": ranking.id, **ranking.model_dump(mode="json")},
        labels=[
            wire.Label(
                index=index,
                label=meaning.label,
                mapped_to=list(meaning.mapped_to),
                trained=meaning.trained,
                dynamic=meaning.label in recipe.dynamic,
                colour="#{:02x}{:02x}{:02x}".format(*colour(meaning.label)),
            )
            for index, meaning in enumerate(state.meanings)
        ],
        vocabulary={
            "sha256": recipe.vocabulary,
            "vocabulary_size": {name: channel.vocabulary_size for name, channel in channels},
            "dimensions": {name: channel.length for name, channel in channels},
        },
        preset_differences=[
            wire.PresetDifference(parameter=one.parameter, value=one.value, preset=one.preset)
            for one in state.preset_differences
        ],
        decision=_map_decision(state),
        keep_queries=record.keep_queries,
        keep_matches=record.keep_matches,
        refuse_poor=record.refuse_poor,
        keep_images=record.keep_images,
        shadow=record.shadow,
        blur=list(record.blur),
        extent=None if lowest is None or highest is None else wire.Extent(minimum=lowest, maximum=highest),
        created_at=record.created_at,
    )


def _map_decision(state: MapState) -> wire.MapDecision:
    levels, own, wanted = state.levels, state.own, state.record.ranking.precision
    source: Literal["cohort", "own-views", "calibration"]
    source = "own-views" if own_share(levels) > 0.5 else "cohort"
    return wire.MapDecision(
        source=source if own is None else "calibration",
        views_compared=levels.current,
        expected=wire.ExpectedDecisions(
            precision=wanted if own is None else own.precision(wanted),
            matched_share=state.calibration.share(wanted),
            queries=None if own is None else own.queries,
        ),
        updated_at=levels.updated_at if own is None else datetime.fromisoformat(own.made_at),
    )


def place(record: PlaceRecord) -> wire.Place:
    """A place."""
    return wire.Place(**{**record._asdict(), "position": position(record.position)})


def labelled_view(labelled: LabelledView) -> wire.View:
    """A view, with the labels of the recipe that it is described by."""
    return view(labelled.record, labelled.labels)


def dynamic_preview(map_name: str, preview: DynamicPreview) -> wire.DynamicPreview:
    """What would be left out of a map's views."""
    return wire.DynamicPreview(
        map=map_name,
        views=preview.views,
        before=preview.before,
        after=preview.after,
        nothing_left=preview.nothing_left,
        labels=[wire.DroppedLabel(label=name, share=share, views=views) for name, share, views in preview.labels],
        most=[wire.DroppedView(view=labelled_view(one), share=share) for one, share in preview.most],
    )


def query_answer(result: QueryResult) -> wire.QueryAnswer:
    """The answer to a query."""
    results, decision = result.results, result.decision
    recipe = results.recipe.description
    first = results.first_map
    searched = {one.name: (one, of.results) for of in result.found for one in of.results.maps}
    several = [searched[name] for name in result.names]
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
        searched=sum(one.searched for one, _ in several),
        pending=sum(one.pending for one, _ in several),
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
        maps=[_map_answer(one, of, places) for one, of in several] if len(several) > 1 else None,
        drive=None if result.driven is None else _drive(result.driven, results),
        matches=matches,
        estimate=estimate(results, decision, {match.view.id for match in matches}),
        timing_ms=dict(result.timing_ms),
    )


def _places(result: QueryResult) -> list[wire.PlaceProbability]:
    """All places, likeliest first; those that were ranked together in their own order."""
    places = []
    for found, part in zip(result.found, result.joined.parts, strict=True):
        bounds = accumulate((place.probability for place in part.places), min)
        places += [(-bound, _place(place, found.results)) for bound, place in zip(bounds, part.places, strict=True)]
    return [place for _, place in sorted(places, key=itemgetter(0))]


def _matches(result: QueryResult) -> list[wire.Match]:
    """All views, by the probability of their places; those that were ranked together in their own order."""
    views = [
        (confidence, scored, found)
        for found, part in zip(result.found, result.joined.parts, strict=True)
        for scored, confidence in zip(found.results.views, part.confidences, strict=False)
    ]
    views = sorted(views, key=lambda one: -one[0])[: result.top]
    return [
        match(rank, scored, confidence, found, result.id if result.explained and found is result.leading else None)
        for rank, (confidence, scored, found) in enumerate(views, start=1)
    ]


def _map_answer(one: SearchedMap, of: RankedResults, places: Sequence[wire.PlaceProbability]) -> wire.MapAnswer:
    """One of several maps."""
    return wire.MapAnswer(
        map=one.name,
        revision=one.revision,
        recipe=of.recipe.description.id,
        ranking=of.recipe.ranking.id,
        searched=one.searched,
        pending=one.pending,
        probability=min(1.0, sum(place.probability for place in places if place.map == one.name)),
    )


def match(
    rank: int,
    found: ScoredView,
    confidence: float,
    of: SearchOutcome,
    explained: str | None,
) -> wire.Match:
    """One match; `explained` is the query's id when an explanation is kept, else None."""
    recipe, query_graph = of.results.recipe.description, of.description.appearance.graph
    base = f"/views/{found.view.id}"
    explanation = None if explained is None else f"/queries/{explained}/explanation.png?view={found.view.id}"
    return wire.Match(
        rank=rank,
        view=view(found.view, recipe.labels),
        score=found.score,
        confidence=confidence,
        parts=dict(found.parts),
        channels={
            name: wire.ChannelMatch(distance=distance, rank=found.ranks[name])
            for name, distance in found.distances.items()
        },
        dense=None if found.dense is None else wire.DenseMatch.model_validate(found.dense, from_attributes=True),
        graph=None if found.graph is None else _graph(found.graph, recipe, query_graph, explained is not None),
        verification=None if found.verified is None else _verification(found.verified, explained is not None),
        links=wire.MatchLinks(image=f"{base}/image", thumbnail=f"{base}/thumbnail", explanation=explanation),
    )


def _reason(result: QueryResult) -> wire.Reason:
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
    posterior = []
    for one in driven.posterior:
        views = [results.views[i].view for i in one.views]
        place = wire.DrivePlace(
            place=views[0].attributes.place,
            position=position(views[0].attributes.position),
            probability=min(one.probability, 1.0),
            views=[view.id for view in views],
        )
        posterior.append(place)
    return wire.DriveFacts(
        images=driven.images,
        posterior=posterior,
        nowhere=driven.nowhere,
        single_frame_status=driven.single_status,
        agreeing=driven.agreeing,
    )


def _graph(evidence: GraphEvidence, recipe: DescriptionRecipe, query: ContextGraph, explain: bool) -> wire.GraphMatch:
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
    pairs = [(point(pair[:2]), point(pair[2:])) for pair in verified.pairs] if explain else None
    return wire.VerificationMatch(
        inliers=verified.inliers,
        matches=verified.matches,
        transform=None if verified.transform is None else verified.transform.tolist(),
        pairs=pairs,
    )


def estimate(results: RankedResults, decision: Decision, shown: Collection[str]) -> wire.Estimate | None:
    """The estimated position of the query, from those of its matches, whose ids are `shown`; None without a match or
    when the best match has no position.

    Between two storeys nobody is, and positions of the other maps that were searched lie in frames of their own.
    """
    if decision.status == "no_match":
        return None
    places, best = results.ranking.places, results.views[0].seq
    matches = [i for i, one in enumerate(results.views) if one.view.id in shown]
    chosen = [i for i in matches if places.on_one_storey(best, results.views[i].seq)]
    found, weights = [results.views[i] for i in chosen], [(decision.weights or decision.confidences)[i] for i in chosen]
    fix = locate([f.view.attributes.position for f in found], weights, places.positions(best))
    if fix is None:
        return None
    known = position(fix.position)
    assert known is not None, "a fix has a position"
    return wire.Estimate(position=known, radius_m=fix.radius_m, views=[found[i].view.id for i in fix.agreeing])
