"""Blurring: people, vehicles or other things are covered in an image before it is stored."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from schemas.blur import BLUR_GROUPS, MOST_WORDS
from schemas.description import Booleans, PixelField
from schemas.enrolment import EnrolmentOptions
from schemas.errors import BlurChanged, Conflict, InvalidParameters, NothingStatic
from schemas.image import Image, ImageFacts
from schemas.records import Covered, Submitted, ViewAttributes, ViewRecord
from worker.description.ports import Encoder
from worker.description.presets import PRESETS
from worker.description.scheduler import Scheduler
from worker.images import filling
from worker.images.codec import facts
from worker.method import labels
from worker.method.covering import covered
from worker.service.decoded import DecodedImages

ATTEMPTS = 3
"""Times that an image is blurred while what its map blurs changes."""

ALL_COVERED = "all of the image would be blurred, since all of it shows {}; nothing is stored, show more of the place"


class BlurSettings(Protocol):
    """What maps blur."""

    def blur(self, name: str) -> tuple[str, ...]:
        """What a map blurs; empty where there is no such map."""
        ...


class Enrolment(Protocol):
    """Storing images."""

    def known(self, name: str, sha256: str, attributes: ViewAttributes) -> ViewRecord | None:
        """The view that a map has of an image, if it is sound and its attributes are these; else None."""
        ...

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

        `covered`: what was blurred in the image, which is then not what was sent.

        Raises
        ------
        LeaseLost
            The job of `options` was cancelled, or went with its map.
        ViewDeleted
            The image was deleted while that job waited or ran.
        ImageEnrolled
            The same image is in the map with other attributes.
        BlurChanged
            The map blurs other things.
        NotFound
            There is no map, and no recipe to create it with.
        DiskFull
        """
        ...


@dataclass(frozen=True, eq=False)
class Blurred:
    """A blurred image: its bytes, and the same decoded."""

    data: bytes
    image: Image


class Cover(Protocol):
    """Blurs images; see `Blurring.cover`."""

    def __call__(self, image: Image, words: Sequence[str], *, waits: bool = False) -> Blurred:
        """A blurred copy of an image."""
        ...


class Blurring:
    """Covers what words name, as far as the segmentation finds it.

    The cells of those labels, found by the segmenter where there is one, with a margin, are replaced by a blend of what
    surrounds them. Everything that is stored afterwards, the description too, is made of the blurred image.

    Parameters
    ----------
    encoder : Encoder
    scheduler : Scheduler
        Of the segmenter, or of the encoder where there is none.
    most_bytes : int
        Of a blurred image, as it is stored.
    """

    def __init__(self, encoder: Encoder, scheduler: Scheduler, most_bytes: int) -> None:
        self._encoder, self._scheduler, self._most_bytes = encoder, scheduler, most_bytes

    def checked(self, words: Sequence[str]) -> tuple[str, ...]:
        """Words without repetitions, in order.

        Raises
        ------
        InvalidParameters
            Too many, or the encoder knows no label that one of them names.
        """
        chosen = tuple(dict.fromkeys(word.strip().casefold() for word in words))
        if len(chosen) > MOST_WORDS:
            raise InvalidParameters.of("blur", f"has {len(chosen)} words; at most {MOST_WORDS} are taken")
        unknown = [word for word in chosen if not self._named(word)]
        if unknown:
            known = ", ".join([*BLUR_GROUPS, *sorted(self._encoder.known_labels or ())])
            raise InvalidParameters.of("blur", f"{', '.join(map(repr, unknown))}: not known; known: {known}")
        return chosen

    def cover(self, image: Image, words: Sequence[str], *, urgent: bool = False, waits: bool = False) -> Blurred:
        """A blurred copy of an image, as JPEG without metadata, whether anything was found in it or not.

        Parameters
        ----------
        image : Image
        words : sequence of str
            As from `checked`.
        urgent : bool
            Whether it goes before enrolments.
        waits : bool
            Whether it waits while a shared encoder, which finds what is blurred, is away.

        Raises
        ------
        NothingStatic
            All of it would be covered.
        Conflict
            The running encoder knows no label that one of the words names.
        Busy
        EncoderAway
            A shared encoder is away, and nobody may wait for it.
        """
        cells = self.cells(image, words, urgent=urgent, waits=waits)
        mask = filling.mask_of(cells, image.width, image.height)
        if mask.all():
            raise NothingStatic(ALL_COVERED.format(", ".join(words)))
        pixels = filling.filled(image.pixels, mask)
        data, form = filling.encoded(pixels, self._most_bytes)
        return Blurred(data, Image(pixels, hashlib.sha256(data).hexdigest(), form, len(data)))

    def cells(self, image: Image, words: Sequence[str], *, urgent: bool = False, waits: bool = False) -> Booleans:
        """The cells of an image that show what words name, bool of shape (rows, columns); raises as `cover`."""
        unknown = [word for word in words if not self._named(word)]
        if unknown:
            raise Conflict(
                f"the encoder {self._encoder.name} finds no {', '.join(unknown)}, which the map blurs; run the encoder "
                "that the map was made with"
            )
        wanted = {label for word in words for label in self._named(word)}
        scored = [*wanted, *(label for label in self._others() if label not in wanted)]
        vectors = self._encoder.text_vectors(scored)
        is_wanted = np.array([label in wanted for label in scored])

        def find(image: Image, field: PixelField) -> Booleans:
            return covered(labels.scores(field.semantic, vectors), is_wanted)

        return self._scheduler.submit(image, find, urgent=urgent, waits=waits).result().value

    def _named(self, word: str) -> list[str]:
        """The labels that a word names and the encoder knows."""
        known = self._encoder.known_labels
        return [label for label in BLUR_GROUPS.get(word, (word,)) if known is None or label in known]

    def _others(self) -> list[str]:
        """Labels that compete for the cells of an image: those of streets and rooms that the encoder knows."""
        known = self._encoder.known_labels
        every = PRESETS["default"].labels
        return [label for label in every if known is None or label in known] or sorted(known or ())


class BlurringEnrolment:
    """Stores images, blurred where their map says so. Nothing of the image that was sent is written anywhere.

    Parameters
    ----------
    enrolment : Enrolment
    maps : BlurSettings
    cover : Cover
    decoded : DecodedImages
        Gets each image that is to be described and was not blurred: what is described is what the stored bytes show.
    """

    def __init__(self, enrolment: Enrolment, maps: BlurSettings, cover: Cover, decoded: DecodedImages) -> None:
        self._enrolment, self._maps, self._cover, self._decoded = enrolment, maps, cover, decoded

    def known(self, name: str, sha256: str, attributes: ViewAttributes) -> ViewRecord | None:
        """As `Enrolment.known`, by the digest of what was sent."""
        return self._enrolment.known(name, sha256, attributes)

    def submit(
        self, name: str, data: bytes, image: Image, attributes: ViewAttributes, options: EnrolmentOptions
    ) -> Submitted:
        """Store an image durably and queue its description; `image` is `data` decoded, not altered since.

        Raises
        ------
        NothingStatic
            The map blurs all of it. Nothing is stored.
        EncoderAway
            A shared encoder would have to find what is blurred, and is away. Nothing is stored; what is imported in the
            background waits instead.
        Conflict, LeaseLost, ViewDeleted, NotFound, DiskFull, StorageFailed
            As the store says.
        """
        for _ in range(ATTEMPTS - 1):
            with suppress(BlurChanged):
                return self._submit(name, data, image, attributes, options)
        return self._submit(name, data, image, attributes, options)

    def _submit(
        self, name: str, data: bytes, image: Image, attributes: ViewAttributes, options: EnrolmentOptions
    ) -> Submitted:
        """As `submit`; raises BlurChanged where what the map blurs was changed meanwhile."""
        words = self._maps.blur(name)
        if words:
            blurred = self._cover(image, words, waits=options.background)
            hidden = Covered(words, image.digest)
            return self._enrolment.submit(name, blurred.data, facts(blurred.image), attributes, options, hidden)
        submitted = self._enrolment.submit(name, data, facts(image), attributes, options)
        if submitted.job_id is not None:
            self._decoded.keep(image)
        return submitted
