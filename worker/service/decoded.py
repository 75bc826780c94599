"""Images handed on, decoded, from where they are stored to where they are described."""

import threading

from schemas.image import Image


class DecodedImages:
    """Keeps a few decoded images until the worker of this process describes them.

    Without it each enrolled image would be read from the store and decoded a second time. What is not here, since there
    was no room or another process stored it, still is.

    Parameters
    ----------
    most_bytes : int
        Of pixels that are kept at most; 0: no image is.
    """

    def __init__(self, most_bytes: int) -> None:
        self._room = most_bytes
        self._images: dict[str, Image] = {}
        self._lock = threading.Lock()

    def keep(self, image: Image) -> None:
        """Keep an image, by its digest, if there is room. None is dropped for it: earlier ones are used first."""
        with self._lock:
            if image.digest not in self._images and image.pixels.nbytes <= self._room:
                self._images[image.digest] = image
                self._room -= image.pixels.nbytes

    def take(self, digest: str) -> Image | None:
        """The image with a SHA-256, which is not kept any longer; None when it is not here."""
        with self._lock:
            image = self._images.pop(digest, None)
            if image is not None:
                self._room += image.pixels.nbytes
            return image

    def clear(self) -> None:
        """Drop all images, once none waits for its description."""
        with self._lock:
            self._room += sum(image.pixels.nbytes for image in self._images.values())
            self._images.clear()
