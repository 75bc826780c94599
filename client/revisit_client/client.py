"""The client: one method per call of the service."""

import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from itertools import islice
from types import TracebackType
from typing import Any, Literal, Self

import httpx
from pydantic import RootModel

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.health import HealthCalls
from revisit_client.images import ImageCalls
from revisit_client.jobs import JobCalls
from revisit_client.maps import MapCalls
from revisit_client.parameters import (
    Image,
    Time,
    address,
    filters,
    header_text,
    listed,
    named,
    readable,
    texts,
    utc,
)
from revisit_client.shadows import ShadowCalls
from revisit_client.snapshots import SnapshotCalls

DEFAULT_URL = "http://127.0.0.1:8000"


class Revisit(MapCalls, ImageCalls, JobCalls, HealthCalls, ShadowCalls, SnapshotCalls):
    """A client of one service. A `with` statement closes its connections; threads may share it.

    Parameters
    ----------
    url : str or None
        Address of the service; None takes ``REVISIT_URL``, or `DEFAULT_URL`.
    key : str or None
        Key of the service; None takes ``REVISIT_KEY``, or sends none.
    timeout : float
        Seconds without anything from the service after which an answer is given up; one that keeps coming is not, and
        that to a recording or a snapshot, which comes once all of it is stored, is waited for without end.
    patience : float
        Seconds over which a call is repeated while the service is busy (429) or starting (503; Retry-After is
        honoured), after a lost answer, and where a service that answered before is away (a refused connection, a
        gateway's 502 or 504). 0 never repeats. Enrolments carry an Idempotency-Key, so that repeating is safe.
    transport : httpx.BaseTransport or None
        For tests.
    sleep, clock : callable
        For tests; both in seconds.

    Raises
    ------
    RevisitProblem
        From every call: the service refused it.
    Unreachable
        From every call: no service answers.
    Unsendable
        `url` or `key` is none.
    ClientError
        A proxy or certificates that the environment names cannot be used.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        key: str | None = None,
        timeout: float = 60.0,
        patience: float = 60.0,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sleep, self._clock = sleep, clock
        self._connection = Connection(
            (url or os.environ.get("REVISIT_URL") or DEFAULT_URL).rstrip("/"),
            key=key or os.environ.get("REVISIT_KEY"),
            timeout=timeout,
            patience=patience,
            transport=transport,
            sleep=sleep,
            clock=clock,
        )
        self.url = self._connection.url
        """Address of the service, as messages show it: without a password."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._connection.close()

    # enrol and query

    def enroll(
        self,
        image: Image,
        *,
        map: str | None = None,
        place: str | None = None,
        x: float | None = None,
        y: float | None = None,
        z: float | None = None,
        lat: float | None = None,
        lon: float | None = None,
        alt: float | None = None,
        heading: float | None = None,
        captured_at: Time | None = None,
        metadata: Mapping[str, Any] | None = None,
        filename: str | None = None,
        refuse_poor: bool | None = None,
        exif: bool = False,
        wait: bool = True,
        idempotency_key: str | None = None,
    ) -> wire.Enrolled:
        """Enrol an image.

        Parameters
        ----------
        image : bytes or path
        map : str or None
            None for the map ``default``. A map is made by its first enrolment.
        place : str or None
            Your own name for the place.
        x, y, z : float or None
            Position in metres, in the map's frame.
        lat, lon, alt : float or None
            Position in degrees (WGS 84) and metres above the ellipsoid; not together with `x`, `y`, `z`.
        heading : float or None
            Degrees clockwise from north, or from +y.
        captured_at : datetime or str or None
            A datetime without a zone is local time; a string is RFC 3339.
        metadata : mapping or None
            Any JSON object; at most 16 KB, 8 levels.
        filename : str or None
            File name to show with the view; None: the last part of the path, none for bytes.
        refuse_poor : bool or None
            Refuse an image that is dark, overexposed, covered or blurred, shows mostly what moves or is nearly in the
            map already, instead of enrolling it with a warning; with `wait` False the last two become views that
            ``failed``. None: as the map says.
        exif : bool
            Take position, heading and time from the image's EXIF where none is given.
        wait : bool
            True: the view is searchable when this returns, unless the service describes it for longer than it waits
            (`REVISIT_WAIT`) and `job` is set. False: it is stored durably, and `job` describes it later.
        idempotency_key : str or None
            Calls with the same key are done once; 1 to 255 visible ASCII characters. None makes a key for this call and
            its repetitions.
        """
        attributes = {"x": x, "y": y, "z": z, "lat": lat, "lon": lon, "alt": alt, "heading": heading, "place": place}
        fields = texts({**attributes, "map": map, "captured_at": captured_at, "metadata": metadata, "wait": wait})
        fields |= texts({"refuse_poor": refuse_poor, "exif": exif or None})
        # One key for all repetitions of this call: the service does the work once even when an answer is lost.
        headers = {"Idempotency-Key": header_text(idempotency_key or uuid.uuid4().hex, "the Idempotency-Key")}
        name, data = named(image)
        name = readable(filename) if filename else name
        return self._connection.receive(
            wire.Enrolled, "POST", "/enroll", data=fields, files={"image": (name, data)}, headers=headers
        )

    def query(
        self,
        image: Image,
        *,
        map: str | None = None,
        maps: Sequence[str] | None = None,
        top: int | None = None,
        candidates: int | None = None,
        precision: float | None = None,
        zoom: float | None = None,
        roll: float | None = None,
        explain: bool | None = None,
        changes: bool | None = None,
        drive: str | None = None,
        drive_timeout: float | None = None,
        consistent: int | None = None,
        near: tuple[float, float, float] | None = None,
        geographic: bool | None = None,
        after: Time | None = None,
        before: Time | None = None,
        place: str | None = None,
        metadata: Mapping[str, str] | None = None,
        where: Mapping[str, Any] | str | None = None,
        exclude_last: int | str | timedelta | None = None,
        exclude: Sequence[str] = (),
        idempotency_key: str | None = None,
    ) -> wire.QueryAnswer:
        """Find the views of a map, or of several, that show the place of an image.

        Parameters
        ----------
        image : bytes or path
        map : str or None
            None for the map ``default``.
        maps : sequence of str or None
            Names of several maps, instead of `map`: one verdict over all of them.
        top : int or None
            How many matches at most.
        candidates : int or None
            Candidates of each channel to re-rank; 0 ranks by the histograms alone. None: the map's.
        precision : float or None
            Share of answers with the status matched that must be right, 0.5 to 0.999. None: the map's.
        zoom : float or None
            How many times as large the image's camera shows things as the map's, .25 to 4: see `zoom_between`. None: 1.
        roll : float or None
            Degrees by which the camera was turned clockwise around its line of sight. None: 0.
        explain : bool or None
            Whether matches list their correspondences, and `explanation` can draw them.
        changes : bool or None
            Whether the answer says what is gone, new or moved since the first match was taken.
        drive : str or None
            Name of a drive that the image is the next one of: the evidence of its images adds up.
        drive_timeout : float or None
            Seconds of silence after which the drive begins anew. None: 60.
        consistent : int or None
            Images of the drive in a row that must be matched one by one and come back to one stretch of the map,
            instead of adding up.
        near : (float, float, float) or None
            Only views near a point: x, y or latitude, longitude, and the radius in metres.
        geographic : bool or None
            Whether `near` is in degrees; None: as the map's positions are. A map with both needs to be told.
        after, before : datetime or str or None
            Only views captured from `after` to `before`, both included; as `captured_at` of `enroll`.
        place : str or None
            Only views of this place.
        metadata : mapping or None
            Only views whose metadata has these values, compared as text.
        where : mapping or str or None
            Only views of which this condition holds, such as ``{"metadata.floor": {"$gte": 2}}``.
        exclude_last : int or str or timedelta or None
            Leave out the newest N views, or those of the last seconds (``"30s"``): for loop closure.
        exclude : sequence of str
            Ids of views to leave out.
        idempotency_key : str or None
            With `drive`: the image before, sent again with its key, counts once. None: a new key for each call.
        """
        chosen = filters(near, geographic, after, before, place, metadata, where, exclude_last, exclude)
        options = {"map": map, "top": top, "candidates": candidates, "precision": precision, "explain": explain}
        options |= {
            "zoom": zoom,
            "roll": roll,
            "changes": changes,
            "maps": listed(maps),
            "drive": drive,
            "drive_timeout": drive_timeout,
            "consistent": consistent,
        }
        # An image of a drive counts once, however often it is sent until an answer arrives.
        key = idempotency_key or (None if drive is None else uuid.uuid4().hex)
        headers = {} if key is None else {"Idempotency-Key": header_text(key, "the Idempotency-Key")}
        name, data = named(image)
        fields = texts({**options, **chosen})
        return self._connection.receive(
            wire.QueryAnswer, "POST", "/query", data=fields, files={"image": (name, data)}, headers=headers
        )

    # views

    def views(
        self,
        map: str | None = None,
        *,
        state: Literal["pending", "ready", "failed"] | None = None,
        newest_first: bool = False,
        words: str | None = None,
        near: tuple[float, float, float] | None = None,
        geographic: bool | None = None,
        after: Time | None = None,
        before: Time | None = None,
        place: str | None = None,
        metadata: Mapping[str, str] | None = None,
        where: Mapping[str, Any] | str | None = None,
        exclude_last: int | str | timedelta | None = None,
        exclude: Sequence[str] = (),
        limit: int | None = None,
        page: int = 100,
    ) -> Iterator[wire.View]:
        """Iterate over the views that pass the filters, at most `limit`; fetched in pages of `page` as needed. With
        `words`, labels such as ``"fence,pole+sign"``, by how much of them these are."""
        chosen = filters(near, geographic, after, before, place, metadata, where, exclude_last, exclude)
        sort = "-enrolled_at" if newest_first else None
        page = page if limit is None else max(1, min(page, limit))
        params = texts({"map": map, "state": state, "sort": sort, "words": words, "limit": page, **chosen})
        yield from islice(
            (view for answer in self._connection.pages(wire.Views, "/views", params) for view in answer.views), limit
        )

    def view(self, view_id: str) -> wire.View:
        """One view."""
        return self._connection.receive(wire.View, "GET", address("views", view_id))

    def patch(self, view_id: str, **attributes: Any) -> wire.View:
        """Change `place`, `x`, `y`, `z`, `lat`, `lon`, `alt`, `heading`, `position` (a mapping of these), `captured_at`
        or `metadata` of a view; None removes a value."""
        attributes = {name: wire.rfc3339(utc(v)) if isinstance(v, datetime) else v for name, v in attributes.items()}
        return self._connection.receive(wire.View, "PATCH", address("views", view_id), json=attributes)

    def delete(self, view_id: str) -> wire.Deleted:
        """Delete a view and its image; the receipt names the snapshots that still have it."""
        return self._connection.receive(wire.Deleted, "DELETE", address("views", view_id))

    def delete_views(
        self,
        map: str,
        *,
        all: bool = False,
        near: tuple[float, float, float] | None = None,
        geographic: bool | None = None,
        after: Time | None = None,
        before: Time | None = None,
        place: str | None = None,
        metadata: Mapping[str, str] | None = None,
        where: Mapping[str, Any] | str | None = None,
        exclude_last: int | str | timedelta | None = None,
        exclude: Sequence[str] = (),
    ) -> wire.Deleted:
        """Delete the views of a map that pass the filters, as of `query`, or all of them with `all`."""
        chosen = filters(near, geographic, after, before, place, metadata, where, exclude_last, exclude)
        params = texts({"map": map, "all": True if all else None, **chosen})
        return self._connection.receive(wire.Deleted, "DELETE", "/views", params=params)

    # the service

    def readyz(self) -> wire.Readiness:
        """Whether the service is ready, and its checks; answers also when it is not ready."""
        return self._connection.receive(wire.Readiness, "GET", "/readyz", repeat=False, accept=503)

    def version(self) -> wire.Version:
        """Versions of the service, its encoder and its libraries."""
        return self._connection.receive(wire.Version, "GET", "/version")

    def openapi(self) -> dict[str, Any]:
        """The service's OpenAPI document."""
        return self._connection.receive(RootModel[dict[str, Any]], "GET", "/openapi.json").root
