"""Images of views: as enrolled, as thumbnail, segmentation, context graph, or explanation of a match."""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np

from schemas.description import ContextGraph, PixelField
from schemas.errors import BadImage, ImageNotKept, NotFound
from schemas.image import Image
from schemas.records import MapRecord, ViewRecord
from worker.description.describer import Describer
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler
from worker.images import drawing, stripping
from worker.images.drawing import Pixels
from worker.images.explanation import explanation_png
from worker.search.ports import DescriptionReader
from worker.service.explanations import Explained, Explanations
from worker.service.ports import Maps, Views
from worker.service.results import ScoredView
from worker.service.sheets import sheet

T = TypeVar("T")
Network = Literal["encoder", "segmenter"]

SEGMENTED = "Labels of the segmentation network. The method, and graph.png, use the encoder's coarser cells."
GRAPHED = "Regions of the encoder's cells, as the method compares them. segmentation.png is of a finer network."


class RenderingService:
    """The use-cases that return images.

    What is drawn over a photo is found in a network's thread and drawn in the caller's, so that no query waits for a
    drawing; one at a time, since large photos take much memory.

    Parameters
    ----------
    maps, views, descriptions
        Parts of the store.
    describers : Describers
    scheduler, segmenting
        See `worker.runtime.parts.Parts`.
    decode : function
        Bytes to Image; raises BadImage.
    thumbnail : function
        Bytes and longer side in pixels to the bytes of a JPEG.
    explanations : Explanations
        The latest explained queries.

    Attributes
    ----------
    segmented_by : {"encoder", "segmenter"}
        The network whose labels a segmentation shows. A context graph is always that of the encoder.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        views: Views,
        descriptions: DescriptionReader,
        describers: Describers,
        scheduler: Scheduler,
        segmenting: Scheduler | None,
        decode: Callable[[bytes], Image],
        thumbnail: Callable[[bytes, int], bytes],
        explanations: Explanations,
    ) -> None:
        self._maps, self._views, self._descriptions = maps, views, descriptions
        self._describers, self._scheduler, self._segmenting = describers, scheduler, segmenting or scheduler
        self.segmented_by: Network = "encoder" if segmenting is None else "segmenter"
        self._decode, self._thumbnail, self._explanations = decode, thumbnail, explanations
        self._drawing = threading.Lock()

    def image(self, view_id: str) -> tuple[bytes, str]:
        """The enrolled image without metadata, and its media type; raises NotFound.

        The pixels are those that were enrolled; an image without metadata is the enrolled bytes. One whose structure
        cannot be followed is given as PNG, and HEIC, which few browsers show, as JPEG.
        """
        record, data = self._views.get(view_id), self._views.image(view_id)
        if record.image.format == "heic":
            return self._thumbnail(data, max(record.image.width, record.image.height)), "image/jpeg"
        with suppress(ValueError, BadImage):
            stripped = stripping.strip(data, record.image.format)
            # Decoders guess where a damaged TIFF or BMP has its pixels; rewritten it could have others.
            if record.image.format not in ("tiff", "bmp") or stripped == data or self._are_alike(data, stripped):
                return stripped, f"image/{record.image.format}"
        return drawing.encode_png(self._decode(data).pixels), "image/png"

    def _are_alike(self, one: bytes, other: bytes) -> bool:
        return np.array_equal(self._decode(one).pixels, self._decode(other).pixels)

    def thumbnail(self, view_id: str, longest: int) -> bytes:
        """A JPEG of at most `longest` pixels on its longer side; raises NotFound."""
        return self._thumbnail(self._views.image(view_id), longest)

    def segmentation(self, view_id: str, *, overlay: bool, legend: bool = False) -> bytes:
        """The label map of a view as an indexed PNG, or blended over the photo; from the segmenter, where there is one.

        Both are as large as the photo; with `legend`, an overlay has a key below it.

        Raises
        ------
        NotFound, Busy
        """
        owner, image = self._source(view_id)
        if overlay:
            return self.draw_overlay(image, owner, legend=legend)
        labels = self._found(image, owner, Describer.segment, self._segmenting).labels
        with self._drawing:
            return drawing.segmentation_png(labels, (image.width, image.height), owner.description.labels)

    def graph(self, view_id: str, *, legend: bool = False) -> bytes:
        """The context graph of a view, drawn over the photo, with `legend` above a key; raises NotFound, Busy."""
        owner, image = self._source(view_id)
        return self.draw_graph(image, owner, legend=legend)

    def draw_overlay(self, image: Image, owner: MapRecord, *, legend: bool = False) -> bytes:
        """An image with its labels by a map's recipe blended over it, dynamic cells grey, as PNG; raises Busy."""
        caption = SEGMENTED if self.segmented_by == "segmenter" else ""
        found = self._found(image, owner, Describer.segment, self._segmenting)
        labels = owner.description.labels
        with self._drawing:
            return drawing.overlay_png(image.pixels, found.labels, labels, found.static, legend=legend, caption=caption)

    def draw_graph(self, image: Image, owner: MapRecord, *, legend: bool = False) -> bytes:
        """An image with its context graph by a map's recipe drawn over it, as PNG; raises Busy."""
        caption = GRAPHED if self.segmented_by == "segmenter" else ""
        graph, recipe = self._found(image, owner, _graph, self._scheduler), owner.description
        with self._drawing:
            return drawing.graph_png(
                image.pixels,
                graph,
                recipe.labels,
                owner.ranking.graph_max_edge,
                dynamic=recipe.dynamic,
                legend=legend,
                caption=caption,
            )

    def maps_of_query(self, query_id: str) -> tuple[str, ...]:
        """The maps that an explained query was asked of: what is drawn may be of any; raises NotFound."""
        return self._explanations.get(query_id).maps

    def explanation(self, query_id: str, view_id: str | None) -> bytes:
        """What decided about a match, and why a rival lost, as PNG; raises NotFound."""
        explained = self._explanations.get(query_id)
        return self.draw_explanation(explained, explained.view(view_id))

    def draw_explanation(self, explained: Explained, scored: ScoredView) -> bytes:
        """What decided about one of a query's matches, as PNG; raises NotFound when its view was deleted."""
        scored = self._now(scored)
        image = self._photo(scored)
        against, other = explained.compared_with(scored), None
        if against is not None:
            with suppress(NotFound):  # deleted since: the match is explained without it
                against = self._now(against)
                other = against, self._photo(against)
        seqs = [scored.seq] if other is None else [scored.seq, other[0].seq]
        cells = self._descriptions.cells(seqs, explained.recipe.description.id)
        return explanation_png(sheet(explained, scored, image, other, cells))

    def _now(self, scored: ScoredView) -> ScoredView:
        """With its view as it is now: one that was given another name is not called what it was; raises NotFound."""
        return replace(scored, view=self._views.get(scored.view.id))

    def _photo(self, scored: ScoredView) -> Pixels | None:
        """The photo of a view; None where its map keeps none."""
        with suppress(ImageNotKept):
            return self._decode(self._views.image(scored.view.id)).pixels
        return None

    def version(self, view_id: str, kind: str) -> str:
        """A version of an image made from a view, for an ETag; `kind` names the image and its options.

        Raises
        ------
        NotFound
        ImageNotKept
            A cache must not be told that its copy of an image which was removed is current.
        """
        record = self._views.get(view_id)
        owner = self._maps.get(record.map)
        refuse_forgotten(record, owner)
        if kind.startswith(("image", "thumbnail")):
            return f"{record.image.sha256[:24]}-{kind}"
        ranked = f"-{owner.ranking.id}" if kind.startswith("graph") else ""  # the ranking limits the length of edges
        return f"{record.id}-{owner.description.id}{ranked}-{kind}"

    def _source(self, view_id: str) -> tuple[MapRecord, Image]:
        owner = self._maps.get(self._views.get(view_id).map)
        return owner, self._decode(self._views.image(view_id))

    def _found(
        self, image: Image, owner: MapRecord, find: Callable[[Describer, PixelField], T], scheduler: Scheduler
    ) -> T:
        """What a map's describer finds in the field that a scheduler's network makes of an image; raises Busy."""
        describer = self._describers.of(owner.description)

        def finish(_: Image, field: PixelField) -> T:
            return find(describer, field)

        return scheduler.submit(image, finish, urgent=True).result().value


def refuse_forgotten(view: ViewRecord, owner: MapRecord) -> None:
    """Raise ImageNotKept for a view whose map keeps no images of described views."""
    if view.state == "ready" and not owner.keep_images:
        raise ImageNotKept(view.id)


def _graph(describer: Describer, field: PixelField) -> ContextGraph:
    return describer.graph(field, describer.segment(field))
