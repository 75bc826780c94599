"""Answers as geographic poses: OGC GeoPose 1.0 (OGC 21-056r11) and the OSCP GeoPose protocol, version 2.

Position and orientation are those of the views that matched, within the radius of the estimate: the service recognises
a place, it measures no pose.
"""

import base64
import binascii
import math
import re
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from schemas.errors import BadBody, InvalidParameters, NoPose, ParameterError
from schemas.wire import QueryAnswer

Json = dict[str, Any]

OGC = "application/geopose+json"
OSCP = "application/vnd.oscp+json"
OSCP_LEVEL = "2.0"
OSCP_VERSION = f"{OSCP};version={OSCP_LEVEL}"

HEADING_SD = 20.0
"""Degrees by which a camera that recognises a view may be turned against it, as a standard deviation."""

ANY_HEADING_SD = 180.0
"""The same where no heading of the view is known."""

LEAST_NEAR_M = 100.0
"""Smallest radius of a search around a prior, metres: what phones are wrong by between houses."""

MOST_READINGS = 1000
"""Readings, or prior poses, of one request; the last is read."""

ANYWHERE_M = 1e7
"""Accuracy from which a prior says nothing, metres: a quarter of the way around the globe."""


class _Sent(BaseModel):
    """Base of what a request is read as: no conversion of types, and fields that are not read are left out.

    A field that is null counts as left out: many libraries write so what an object does not have.
    """

    model_config = ConfigDict(strict=True)

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, given: Any) -> Any:
        return {key: value for key, value in given.items() if value is not None} if isinstance(given, dict) else given


class Orientation(_Sent):
    """How the camera held the image."""

    mirrored: bool = False
    rotation: float = 0.0


class CameraReading(_Sent):
    """One image."""

    image_bytes: str = Field(alias="imageBytes", description="Base64 of an image file.")
    orientation: Orientation = Field(default_factory=Orientation, alias="imageOrientation")
    privacy: Json | None = Field(None, description="Where it is given, the image is not kept for unknown places.")


class GeolocationReading(_Sent):
    """Where the phone takes itself to be, WGS 84."""

    latitude: float = Field(ge=-90, le=90)
    longitude: float = Field(ge=-180, le=180)
    accuracy: float = Field(0.0, ge=0, description="Metres.")


class SensorReadings(_Sent):
    """What the phone has measured."""

    camera_readings: list[CameraReading] = Field(alias="cameraReadings", min_length=1, max_length=16)
    geolocation_readings: list[GeolocationReading] = Field(
        default_factory=list, alias="geolocationReadings", max_length=MOST_READINGS
    )


class PriorPosition(_Sent):
    """A position of WGS 84."""

    lat: float = Field(ge=-90, le=90)
    lon: float = Field(ge=-180, le=180)


class PriorGeoPose(_Sent):
    """A pose, of which the position is read."""

    position: PriorPosition


class PriorAccuracy(_Sent):
    """How far off a prior may be."""

    position: float = Field(0.0, ge=0, description="Metres.")


class Prior(_Sent):
    """A pose that was known before: the protocol's own answer, sent back, or the pose in it alone."""

    geopose: PriorGeoPose
    accuracy: PriorAccuracy = Field(default_factory=PriorAccuracy)

    @model_validator(mode="before")
    @classmethod
    def _whole(cls, given: Any) -> Any:
        bare = isinstance(given, Mapping) and "geopose" not in given and "position" in given
        return {"geopose": given} if bare else given


class GeoPoseRequest(_Sent):
    """A request of the OSCP GeoPose protocol."""

    id: str = Field(max_length=200)
    type: Literal["geopose"] = "geopose"
    readings: SensorReadings = Field(alias="sensorReadings")
    priors: list[Prior] = Field(default_factory=list, alias="priorPoses", max_length=MOST_READINGS)

    def image(self) -> bytes:
        """The first image.

        Raises
        ------
        InvalidParameters
            It is no base64, or not upright.
        BadBody
            It is empty.
        """
        reading = self.readings.camera_readings[0]
        where = "sensorReadings.cameraReadings.0."
        if reading.orientation.mirrored or reading.orientation.rotation % 360:
            raise InvalidParameters(
                [ParameterError(where + "imageOrientation", "send the image upright, or with EXIF")]
            )
        if not reading.image_bytes:
            raise BadBody("no-picture", f"`{where}imageBytes` is empty; send an image file in base64")
        try:
            return base64.b64decode(reading.image_bytes, validate=True)
        except (binascii.Error, ValueError):
            wrong = "is no base64; send it without line breaks, and without `data:` before it"
            raise InvalidParameters([ParameterError(where + "imageBytes", wrong)]) from None

    def near(self) -> tuple[float, float, float] | None:
        """(latitude, longitude, radius in metres) to search in: of the last prior pose, else of the last reading.

        None where there is neither, and where it may be anywhere: clients say so with the largest number that there is.
        """
        if self.priors:
            last = self.priors[-1]
            at, accuracy = (last.geopose.position.lat, last.geopose.position.lon), last.accuracy.position
        elif self.readings.geolocation_readings:
            reading = self.readings.geolocation_readings[-1]
            at, accuracy = (reading.latitude, reading.longitude), reading.accuracy
        else:
            return None
        return None if accuracy > ANYWHERE_M else (*at, max(LEAST_NEAR_M, 3 * accuracy))

    def may_be_kept(self) -> bool:
        """Whether the image may be kept among a map's unknown places: not where it came with wishes for privacy."""
        return all(reading.privacy is None for reading in self.readings.camera_readings)


def wants_geopose(accept: str) -> bool:
    """Whether a caller asks for OGC GeoPose rather than for the service's own answer (RFC 9110, 12.5.1)."""
    return _quality(accept, OGC) > max(_quality(accept, "application/json"), _quality(accept, "*/*"))


def speaks_oscp(accept: str) -> bool:
    """Whether a caller asks for version 2 of the OSCP protocol."""
    for part in accept.split(","):
        name, *options = (word.strip().lower() for word in part.split(";"))
        told = {key.strip(): value.strip().strip('"') for key, _, value in (word.partition("=") for word in options)}
        if name == OSCP and told.get("version") == OSCP_LEVEL and _weight(told.get("q", "1")) > 0:
            return True
    return False


def _quality(accept: str, media_type: str) -> float:
    for part in accept.split(","):
        name, *options = (word.strip().lower() for word in part.split(";"))
        if name == media_type:
            weights = [option[2:] for option in options if option.startswith("q=")]
            return _weight(weights[0]) if weights else 1.0
    return 0.0


def _weight(stated: str) -> float:
    """A weight of RFC 9110, 12.4.2; 0 for what is none."""
    return float(stated) if re.fullmatch(r"0(\.[0-9]{0,3})?|1(\.0{0,3})?", stated) else 0.0


def yaw_of(heading: float) -> float:
    """Yaw in degrees, -180..180, counter-clockwise from east, of a heading in degrees clockwise from north."""
    return 180 - (90 + heading) % 360


def quaternion_of(yaw: float) -> Json:
    """The rotation by a yaw in degrees about the axis that points up, as x, y, z, w."""
    half = math.radians(yaw) / 2
    return {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}


def pose_of(answer: QueryAnswer) -> tuple[Json, float | None, Json]:
    """Position, heading in degrees or None, and accuracy of a sure answer.

    Returns
    -------
    position
        ``lat``, ``lon``, and ``h``: metres above the ellipsoid, 0 where none is known.
    heading
        Of the first match.
    accuracy
        ``position`` in metres, null where it is not known, and ``orientation`` in degrees.

    Raises
    ------
    NoPose
        Nothing is sure, or views of the place have no geographic position.
    """
    if answer.status != "matched":
        raise NoPose(f"{answer.reason.detail}; {answer.reason.remedy}")
    at = None if answer.estimate is None else answer.estimate.position
    if answer.estimate is None or at is None or at.lat is None or at.lon is None:
        raise NoPose(f"the place is known; its views in the map {answer.map!r} lack lat and lon: enrol them with both")
    seen = answer.matches[0].view.position
    heading = None if seen is None else seen.heading
    accuracy = {
        "position": answer.estimate.radius_m,
        "orientation": ANY_HEADING_SD if heading is None else HEADING_SD,
    }
    return {"lat": at.lat, "lon": at.lon, "h": at.alt or 0.0}, heading, accuracy


def basic_ypr(answer: QueryAnswer) -> Json:
    """A Basic-YPR GeoPose (21-056r11, 7.3.1), with its accuracy and confidence beside it; raises as `pose_of`."""
    position, heading, accuracy = pose_of(answer)
    yaw = 0.0 if heading is None else yaw_of(heading)
    angles = {"yaw": yaw, "pitch": 0.0, "roll": 0.0}
    return {"position": position, "angles": angles, "accuracy": accuracy, "confidence": answer.confidence}


def oscp_answer(request_id: str, timestamp_ms: int, answer: QueryAnswer) -> Json:
    """The answer of the OSCP protocol; raises as `pose_of`."""
    position, heading, accuracy = pose_of(answer)
    return {
        "id": request_id,
        "timestamp": timestamp_ms,
        "type": "geopose",
        "accuracy": accuracy,
        "geopose": {"position": position, "quaternion": quaternion_of(0.0 if heading is None else yaw_of(heading))},
    }
