"""Records to answers: what the store knows, as it travels."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime

from schemas import wire
from schemas.description import ContextGraph, Floats
from schemas.recipe import Recipe
from schemas.records import JobRecord, MapCounts, MapRecord, Meaning, Position, Removal, ViewRecord
from worker.images.palette import colour
from worker.method.decision import Decision
from worker.method.estimate import locate
from worker.method.verification import Verified
from worker.search.searcher import GraphEvidence, ScoredView


def position(position: Position) -> wire.Position | None:
    """A position, or None when nothing was said."""
    if all(value is None for value in asdict(position).values()):
        return None
    return wire.Position(**asdict(position))


def label_shares(shares: Floats, labels: Sequence[str]) -> list[wire.LabelShare]:
    """The labels that are present, largest share first."""
    present = [wire.LabelShare(label=w, share=float(s)) for w, s in zip(labels, shares, strict=True) if s > 0]
    return sorted(present, key=lambda entry: -entry.share)


def view(record: ViewRecord, labels: Sequence[str]) -> wire.View:
    """A view; `labels` is the label set of the map's recipe."""
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
            keypoints=description.descriptor_count,
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


def failure(reason: tuple[str, str] | None) -> wire.Failure | None:
    """A reason for failing, if there is one."""
    return None if reason is None else wire.Failure(code=reason[0], detail=reason[1])


def job(record: JobRecord) -> wire.Job:
    """A job."""
    links = {"self": f"/jobs/{record.id}"}
    if record.view_id is not None:
        links["view"] = f"/views/{record.view_id}"
    return wire.Job(
        id=record.id,
        kind="describe",
        state=record.state,
        map=record.map,
        view=record.view_id,
        attempts=record.attempts,
        created_at=record.created_at,
        finished_at=record.finished_at,
        failure=failure(record.failure),
        links=links,
    )


def removal(receipt: Removal) -> wire.Deleted:
    """The receipt of a deletion."""
    return wire.Deleted(views=receipt.views, images=receipt.images, revision=receipt.revision)


def map_facts(record: MapRecord, counts: MapCounts, meanings: Sequence[Meaning]) -> wire.MapFacts:
    """A map; `meanings` says how the encoder understands its labels."""
    recipe = record.recipe
    lowest, highest = position(counts.lowest), position(counts.highest)
    return wire.MapFacts(
        name=record.name,
        revision=record.revision,
        views={"pending": 0, "ready": 0, "failed": 0, **counts.views},
        places=counts.places,
        bytes=counts.image_bytes,
        recipe={"id": recipe.id, **recipe.model_dump(mode="json")},
        labels=[
            wire.Label(
                index=index,
                word=meaning.word,
                mapped_to=list(meaning.mapped_to),
                trained=meaning.trained,
                dynamic=meaning.word in recipe.dynamic,
                colour="#{:02x}{:02x}{:02x}".format(*colour(meaning.word)),
            )
            for index, meaning in enumerate(meanings)
        ],
        vocabulary={
            "sha256": recipe.vocabulary,
            "words": {name: channel.words for name, channel in recipe.parameters.channels.items()},
            "dimensions": {name: channel.length for name, channel in recipe.parameters.channels.items()},
        },
        extent=None if lowest is None or highest is None else wire.Extent(minimum=lowest, maximum=highest),
        created_at=record.created_at,
    )


def unexplained(labels: Sequence[str]) -> list[Meaning]:
    """Meanings of labels that belong to an encoder which is not running."""
    return [Meaning(label, (), trained=False) for label in labels]


def place(row: tuple[str, str, int, Position, datetime]) -> wire.Place:
    """A place: (map, name, views, mean position, last enrolment)."""
    map_name, name, views, mean, last = row
    return wire.Place(map=map_name, place=name, views=views, position=position(mean), last_enrolled_at=last)


def match(
    rank: int, found: ScoredView, confidence: float, recipe: Recipe, query_graph: ContextGraph, explained: str | None
) -> wire.Match:
    """One match; `explained` is the query's id when its explanation is kept."""
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


def _graph(evidence: GraphEvidence, recipe: Recipe, query: ContextGraph, explain: bool) -> wire.GraphMatch:
    pairs = None
    if explain:
        pairs = [
            wire.NodePair(
                label=recipe.labels[query.labels[p]],
                cosine=cosine,
                query=_point(query.positions[p]),
                view=_point(evidence.view.positions[r]),
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
    pairs = [(_point(pair[:2]), _point(pair[2:])) for pair in verified.pairs] if explain else None
    return wire.VerificationMatch(
        inliers=verified.inliers,
        matches=verified.matches,
        transform=None if verified.transform is None else verified.transform.tolist(),
        pairs=pairs,
    )


def _point(position: Floats) -> tuple[float, float]:
    return float(position[0]), float(position[1])


def estimate(found: Sequence[ScoredView], decision: Decision) -> wire.Estimate | None:
    """Where the query was taken, unless nothing matched or the best match has no position."""
    if decision.status == "no_match":
        return None
    fix = locate([f.view.attributes.position for f in found], decision.confidences)
    if fix is None:
        return None
    known = position(fix.position)
    assert known is not None, "a fix has a position"
    return wire.Estimate(position=known, radius_m=fix.radius_m, views=[found[i].view.id for i in fix.agreeing])
