"""Answers as geographic poses: OGC GeoPose 1.0 (OGC 21-056r11) and the OSCP GeoPose protocol, version 2.

Position and orientation are those of the views that matched, within the radius of the estimate: the service recognises
a place, it measures no pose.
"""

import base64
import binascii
import math
from typing import Any

from pydantic import BaseModel, Field

from schemas.errors import InvalidParameters, NoPose, ParameterError
from schemas.wire import QueryAnswer

Json = dict[str, Any]

OGC = "application/geopose+json"
OSCP = "application/vnd.oscp+json"
OSCP_VERSION = f"{OSCP};version=2.0"

HEADING_SD = 20.0
"""Degrees by which a camera that recognises a view may be turned against it, as a standard deviation."""

ANY_HEADING_SD = 180.0
"""The same where no heading of the view is known."""

LEAST_NEAR_M = 100.0
"""Smallest radius of a search around a prior, metres: what phones are wrong by between houses."""


class Orientation(BaseModel):
    """How the camera held the image."""

    mirrored: bool = False
    rotation: float = 0.0


class CameraReading(BaseModel):
    """One image; fields that are not read are left out."""

    image_bytes: str = Field(alias="imageBytes", description="Base64 of an image file.")
    orientation: Orientation = Field(default_factory=Orientation, alias="imageOrientation")
    privacy: Json | None = Field(None, description="Where it is given, the image is not kept for unknown places.")


class GeolocationReading(BaseModel):
    """Where the phone takes itself to be, WGS 84."""

    latitude: float = Field(ge=-90, le=90)
    longitude: float = Field(ge=-180, le=180)
    accuracy: float = Field(0.0, ge=0, description="Metres.")


class SensorReadings(BaseModel):
    """What the phone has measured."""

    camera_readings: list[CameraReading] = Field(alias="cameraReadings", min_length=1, max_length=16)
    geolocation_readings: list[GeolocationReading] = Field(default_factory=list, alias="geolocationReadings")


class PriorPosition(BaseModel):
    """A position of WGS 84."""

    lat: float = Field(ge=-90, le=90)
    lon: float = Field(ge=-180, le=180)


class PriorGeoPose(BaseModel):
    """A pose, of which the position is read."""

    position: PriorPosition


class PriorAccuracy(BaseModel):
    """How far off a prior may be."""

    position: float = Field(0.0, ge=0, description="Metres.")


class Prior(BaseModel):
    """A pose that was known before: the protocol's own answer, sent back."""

    geopose: PriorGeoPose
    accuracy: PriorAccuracy = Field(default_factory=PriorAccuracy)


class GeoPoseRequest(BaseModel):
    """A request of the OSCP GeoPose protocol."""

    id: str = Field(max_length=200)
    readings: SensorReadings = Field(alias="sensorReadings")
    priors: list[Prior] = Field(default_factory=list, alias="priorPoses", max_length=100)

    def image(self) -> bytes:
        """The first image; raises InvalidParameters where it is no base64, or not upright."""
        reading = self.readings.camera_readings[0]
        where = "sensorReadings.cameraReadings.0."
        if reading.orientation.mirrored or reading.orientation.rotation % 360:
            raise InvalidParameters(
                [ParameterError(where + "imageOrientation", "send the image upright, or with EXIF")]
            )
        try:
            return base64.b64decode(reading.image_bytes, validate=True)
        except (binascii.Error, ValueError):
            raise InvalidParameters([ParameterError(where + "imageBytes", "is no base64")]) from None

    def near(self) -> tuple[float, float, float] | None:
        """(latitude, longitude, radius in metres) to search in: of the last prior pose, else of the last reading."""
        if self.priors:
            last = self.priors[-1]
            at, accuracy = (last.geopose.position.lat, last.geopose.position.lon), last.accuracy.position
        elif self.readings.geolocation_readings:
            reading = self.readings.geolocation_readings[-1]
            at, accuracy = (reading.latitude, reading.longitude), reading.accuracy
        else:
            return None
        return (*at, max(LEAST_NEAR_M, 3 * accuracy))

    def may_be_kept(self) -> bool:
        """Whether the image may be kept among a map's unknown places: not where it came with wishes for privacy."""
        return all(reading.privacy is None for reading in self.readings.camera_readings)


def wants_geopose(accept: str) -> bool:
    """Whether a caller asks for OGC GeoPose rather than for the service's own answer (RFC 9110, 12.5.1)."""
    return _quality(accept, OGC) > max(_quality(accept, "application/json"), _quality(accept, "*/*"))


def speaks_oscp(accept: str) -> bool:
    """Whether a caller asks for version 2 of the OSCP protocol."""
    ranges = [part.replace(" ", "").lower() for part in accept.split(",")]
    return any(one.split(";q=")[0] == OSCP_VERSION for one in ranges)


def _quality(accept: str, media_type: str) -> float:
    for part in accept.split(","):
        name, *options = (word.strip().lower() for word in part.split(";"))
        if name == media_type:
            weights = [option[2:] for option in options if option.startswith("q=")]
            try:
                return float(weights[0]) if weights else 1.0
            except ValueError:
                return 0.0
    return 0.0


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
        raise NoPose(f"the place is known; its views in the map {answer.map!r} have no lat and lon: enrol them with")
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
