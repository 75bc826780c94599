"""What a caller wants of an import."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ImportOptions:
    """How a recording is imported.

    Parameters
    ----------
    exif : bool
        Take place and time from EXIF where the manifest says nothing of them.
    panorama : bool
        Every image is an equirectangular panorama, and is enrolled as eight views.
    image_topic, pose_topic : str or None
        Of a ROS 2 recording; None: the only ones.
    refuse_poor : bool or None
        Images that are dark, overexposed, covered or blurred are errors; None: as the map says when the import begins.
    every_s, every_m : float or None
        Least seconds, or metres, from one image to the next; None: all images, and of a video one a second.
    """

    exif: bool = False
    panorama: bool = False
    image_topic: str | None = None
    pose_topic: str | None = None
    refuse_poor: bool | None = None
    every_s: float | None = None
    every_m: float | None = None
