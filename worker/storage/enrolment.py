"""Enrolment: stores an image and its attributes durably, and queues its description."""

from collections.abc import Mapping
from datetime import datetime
from functools import cache
from typing import Any

import sqlalchemy as sa

from schemas.enrolment import EnrolmentOptions
from schemas.errors import BlurChanged, Damaged, ImageEnrolled, NotFound
from schemas.image import ImageFacts
from schemas.records import Covered, Submitted, ViewAttributes, ViewRecord
from worker.storage import checksums, clock, deleted_images, switching
from worker.storage.damage import set_aside_views
from worker.storage.database import Database
from worker.storage.enrolment_order import EnrolmentOrder
from worker.storage.filtering import metadata_pairs
from worker.storage.image_store import ImageStore
from worker.storage.map_jobs import held
from worker.storage.maps import find_or_make_map
from worker.storage.part import Part
from worker.storage.rows import (
    COORDINATES,
    as_json,
    attribute_columns,
    attributes_of,
    blur_of,
    change_view,
    find_map,
    find_view,
    has_whole_attributes,
    inserting,
    view_record,
    view_rows,
)
from worker.storage.tables import JOBS, METADATA_PAIRS, VIEWS


def contradictions(kept: ViewAttributes, anew: ViewAttributes) -> list[str]:
    """Names of the fields that `anew` sets to other values than `kept`."""
    differing = []
    if anew.place is not None and anew.place != kept.place:
        differing.append("place")
    for coordinate in COORDINATES:
        value = getattr(anew.position, coordinate)
        if value is not None and value != getattr(kept.position, coordinate):
            differing.append(coordinate)
    if anew.captured_at is not None and not _is_that_moment(kept.captured_at, anew.captured_at):
        differing.append("captured_at")
    for key, value in anew.metadata.items():
        # As JSON: 1 and true are equal in Python.
        if key not in kept.metadata or as_json(value) != as_json(kept.metadata[key]):
            differing.append(f"metadata.{key}")
    return differing


def _is_that_moment(kept: datetime | None, anew: datetime) -> bool:
    """Whether a time is the one that is kept, or that to more than the whole second which is kept."""
    return kept == anew or (kept is not None and kept == anew.replace(microsecond=0))


def keep_pairs(connection: sa.Connection, seq: int, attributes: ViewAttributes) -> None:
    """Replace the metadata pairs by which a view is found."""
    connection.execute(sa.delete(METADATA_PAIRS).where(METADATA_PAIRS.c.seq == seq))
    pairs = [{"pair": pair, "seq": seq} for pair in metadata_pairs(attributes.metadata)]
    if pairs:
        connection.execute(sa.insert(METADATA_PAIRS), pairs)


def fact_columns(facts: ImageFacts) -> dict[str, Any]:
    """Facts of an image as columns of `views`."""
    return {
        "sha256": facts.sha256,
        "width": int(facts.width),
        "height": int(facts.height),
        "byte_count": int(facts.byte_count),
        "format": facts.format,
    }


@cache
def _having(digest: sa.Column[str]) -> sa.Select[Any]:
    """Selects the view of a map with an image's SHA-256, of what is stored or of what was sent."""
    return view_rows().where(VIEWS.c.map_id == sa.bindparam("map_id"), digest == sa.bindparam("of"))


def _same_image(connection: sa.Connection, map_id: int, sent: str, stored: str) -> sa.Row[Any] | None:
    """The view of a map whose image was sent, or is stored, with these digests."""
    ways = [(VIEWS.c.sha256, sent), (VIEWS.c.sent_sha256, sent)]
    if stored != sent:
        ways.append((VIEWS.c.sha256, stored))
    for column, digest in ways:
        found = connection.execute(_having(column), {"map_id": map_id, "of": digest}).first()
        if found is not None:
            return found
    return None


class Enrolment(Part):
    """See `worker.service.blurring.Enrolment`."""

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._order = EnrolmentOrder()

    def submit(
        self,
        name: str,
        image: bytes,
        facts: ImageFacts,
        attributes: ViewAttributes,
        options: EnrolmentOptions,
        covered: Covered | None = None,
    ) -> Submitted:
        """Store an image durably and queue its description; creates the map, if `options` has a recipe for it.

        For an image that the map has already, the result is its view, which is queued again if it had failed.

        Parameters
        ----------
        name : str
            Of the map.
        image : bytes
            As it is to be stored.
        facts : ImageFacts
        attributes : ViewAttributes
        options : EnrolmentOptions
        covered : Covered or None
            What was blurred in the image; None where it is stored as it was sent.

        Raises
        ------
        ImageEnrolled
            The map has the image with other attributes.
        BlurChanged
            The map blurs other things than those in `covered`.
        NotFound
            There is no map, and no recipe to create it with.
        LeaseLost
            The import was cancelled, or another worker has claimed it.
        ViewDeleted
            The image was deleted while the import waited or ran.
        DiskFull
        ValueError
            The SHA-256 in `facts` is not that of the image.
        """
        if self._database.space is not None:
            self._database.space.admit(len(image), image=True)
        with self._images.kept(facts.sha256, image) as hold, self._database.writing() as connection:
            hold.until_commit(connection)
            claimed = None if options.job is None else held(connection, options.job)
            row = find_or_make_map(connection, name, options.recipe, options.now)
            if blur_of(row) != (() if covered is None else covered.words):
                raise BlurChanged(f"what the map {name!r} blurs was changed meanwhile; try again")
            sent = facts.sha256 if covered is None else covered.sent_sha256
            columns = {**fact_columns(facts), "sent_sha256": None if covered is None else sent}
            view = _same_image(connection, row.id, sent, facts.sha256)
            if view is None:
                if claimed is not None:
                    deleted_images.refuse(connection, claimed.number, {sent, facts.sha256})
                return self._enrol(connection, row, columns, attributes, options)
            submitted = self._enrol_again(connection, row, view, columns, attributes, options)
        if row.drop_images or view.sha256 != facts.sha256:
            # What a view needs stays: where it is to be described, or where this image took the place of another.
            self._images.discard([facts.sha256, view.sha256])
        return submitted

    def known(self, name: str, sha256: str, attributes: ViewAttributes) -> ViewRecord | None:
        """The view that a map has of an image, if it is sound and its attributes are these; else None."""
        with self._database.reading() as connection:
            try:
                row = find_map(connection, name)
            except NotFound:
                return None
            view = _same_image(connection, row.id, sha256, sha256)
            if view is None or view.state == "failed" or not has_whole_attributes(view):
                return None
            return None if contradictions(attributes_of(view), attributes) else view_record(view)

    def _enrol(
        self,
        connection: sa.Connection,
        row: sa.Row[Any],
        image: Mapping[str, Any],
        attributes: ViewAttributes,
        options: EnrolmentOptions,
    ) -> Submitted:
        view_id, elapsed_us = self._order.following(connection, row.id, options.now, options.steady_s)
        columns = {
            "id": view_id,
            "map_id": row.id,
            "enrolled_at": options.now,
            "elapsed_us": elapsed_us,
            **image,
            **attribute_columns(attributes),
        }
        connection.execute(
            inserting(VIEWS), {**columns, "state": "pending", "checksum": checksums.of_row(VIEWS, columns)}
        )
        view = view_record(find_view(connection, view_id))
        self._order.note(view.seq, elapsed_us, options.steady_s)
        keep_pairs(connection, view.seq, attributes)
        job = self._queue(connection, row, view.seq, options)
        return Submitted(view, job, created=True, revision=row.revision)

    def _enrol_again(
        self,
        connection: sa.Connection,
        row: sa.Row[Any],
        view: sa.Row[Any],
        image: Mapping[str, Any],
        attributes: ViewAttributes,
        options: EnrolmentOptions,
    ) -> Submitted:
        if not has_whole_attributes(view):  # what is sent now is what there is
            set_aside_views(connection, [view.seq], options.now)  # nobody may have read it since it was damaged
            anew = {"map_id": row.id, "enrolled_at": options.now, **image, **attribute_columns(attributes)}
            change_view(connection, view, {**anew, "state": "failed"})
            keep_pairs(connection, view.seq, attributes)
            clock.tick_edited(connection, row.id)
            view = find_view(connection, view.id)
        elif view.sha256 != image["sha256"] and (view.state == "failed" or not self._is_readable(view.sha256)):
            # Blurred anew, by another network or on another machine, it came out otherwise.
            change_view(connection, view, image)
            view = find_view(connection, view.id)
        differing = contradictions(attributes_of(view), attributes)
        if differing:
            raise ImageEnrolled(
                f"this image is in the map {row.name!r} already, as {view.id}, with another "
                f"{', '.join(differing)}; PATCH /views/{view.id} changes its attributes"
            )
        job: str | None
        if view.state == "failed":  # sending it again means trying again
            job = self._queue(connection, row, view.seq, options)
            connection.execute(
                sa.update(VIEWS)
                .where(VIEWS.c.seq == view.seq)
                .values(state="pending", failure_code=None, failure_detail=None)
            )
            view = find_view(connection, view.id)
        else:
            job = switching.unfinished_job(connection, view.seq, row.recipe)
        if job is not None:  # the call that enrolled the view may yet take it back
            # An import that goes on after a crash meets its own: nobody else was told of those.
            others = sa.true() if not options.background else ~JOBS.c.background
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job, others).values(told=True))
        return Submitted(view_record(view), job, created=False, revision=row.revision)

    def _is_readable(self, digest: str) -> bool:
        try:
            self._images.read(digest)
        except Damaged:
            return False
        return True

    def _queue(self, connection: sa.Connection, row: sa.Row[Any], seq: int, options: EnrolmentOptions) -> str:
        """Queue the description of a view by the map's recipe and, in a recipe switch, by the next; returns the job."""
        job = switching.unfinished_job(connection, seq, row.recipe)
        if job is None:
            wanted = {"background": options.background, "refuse_poor": options.refuse_poor}
            [job] = switching.queue(connection, row.id, [seq], row.recipe, options.now, **wanted)
        following = row.next_recipe
        if following is not None and not switching.needs_no_job(connection, seq, following):
            switching.queue(connection, row.id, [seq], following, options.now, background=True)
        return job
