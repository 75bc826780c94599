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
    """

    exif: bool = False
    panorama: bool = False
