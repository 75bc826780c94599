"""Turns the results of the use-cases into the models of `schemas.wire`."""

from collections.abc import Sequence
from datetime import datetime
from typing import Literal

from schemas import wire
from schemas.description import Floats
from schemas.records import Failure, JobRecord, PlaceRecord, Position, ViewRecord
from worker.images.palette import colour
from worker.method.features import own_share
from worker.service.maps import MapState
from worker.service.views import DynamicPreview, LabelledView


def position(position: Position) -> wire.Position | None:
    """A position; None when all its fields are None."""
    return None if position == Position() else wire.Position(**vars(position))


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
