"""Parameters of imports."""

from typing import Annotated

from pydantic import AfterValidator, Field

from app.http.validation import Parameters
from schemas import values
from schemas.imports import ImportOptions

Topic = Annotated[str, Field(min_length=1, max_length=255)] | None


def _step(text: str) -> str:
    """Check a step of an import."""
    values.every(text)
    return text


class ImportParameters(Parameters):
    """Parameters of `POST /maps/{map}/imports`."""

    exif: bool = Field(
        False,
        description="Take place and time of an image from its EXIF where no manifest tells them. Not with a video.",
    )
    panorama: bool = Field(
        False, description="Every image is an equirectangular panorama: it is enrolled as eight views, 45° apart."
    )
    refuse_poor: bool | None = Field(
        None,
        description="Leave out images that are dark, overexposed, covered or blurred, show mostly things that move or "
        "are nearly in the map already, as errors of their own. Default: the map's.",
    )
    image_topic: Topic = Field(None, description="Topic of the images, of a ROS 2 recording (MCAP) with several.")
    pose_topic: Topic = Field(None, description="Topic of the poses, of a ROS 2 recording (MCAP) with several.")
    every: Annotated[str, AfterValidator(_step)] | None = Field(
        None,
        examples=["2s", "1m"],
        description="Least time (2s, 1min) or way (1m: metres) from one image to the next; the others are left out. "
        "Default: all images, and of a video one a second.",
    )

    def options(self) -> ImportOptions:
        """The same as a record."""
        amount, unit = (None, "") if self.every is None else values.every(self.every)
        return ImportOptions(
            exif=self.exif,
            panorama=self.panorama,
            refuse_poor=self.refuse_poor,
            image_topic=self.image_topic,
            pose_topic=self.pose_topic,
            every_s=amount if unit == "s" else None,
            every_m=amount if unit == "m" else None,
        )
