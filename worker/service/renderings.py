"""Images of views: as enrolled, as thumbnail, segmentation, context graph, or explanation of a match."""

from collections.abc import Callable

from schemas.description import PixelField
from schemas.image import Image
from schemas.records import MapRecord
from worker.description.describer import Describer
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler
from worker.images import drawing
from worker.service.explanations import Explanations
from worker.service.ports import Maps, Views

Draw = Callable[[Image, PixelField, Describer, MapRecord], bytes]
"""From an image, its pixel field, a describer and the map whose recipe that is, to PNG bytes."""


class RenderingService:
    """The use-cases that return images.

    Parameters
    ----------
    maps, views
        Parts of the store.
    describers : Describers
    scheduler : Scheduler
    decode : function
        Bytes to Image; raises BadImage.
    thumbnail : function
        Bytes and longer side in pixels to the bytes of a JPEG.
    explanations : Explanations
        The latest explained queries.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        views: Views,
        describers: Describers,
        scheduler: Scheduler,
        decode: Callable[[bytes], Image],
        thumbnail: Callable[[bytes, int], bytes],
        explanations: Explanations,
    ) -> None:
        self._maps, self._views = maps, views
        self._describers, self._scheduler = describers, scheduler
        self._decode, self._thumbnail, self._explanations = decode, thumbnail, explanations

    def image(self, view_id: str) -> tuple[bytes, str]:
        """The enrolled bytes and their media type; raises NotFound."""
        record = self._views.get(view_id)
        return self._views.image(view_id), f"image/{record.image.format}"

    def thumbnail(self, view_id: str, longest: int) -> bytes:
        """A JPEG of at most `longest` pixels on its longer side; raises NotFound."""
        return self._thumbnail(self._views.image(view_id), longest)

    def segmentation(self, view_id: str, *, overlay: bool) -> bytes:
        """The label map of a view as an indexed PNG, or blended over the photo; from the segmenter, where there is one.

        Raises
        ------
        NotFound, Busy
        """
        owner, image = self._source(view_id)
        return self.draw_overlay(image, owner) if overlay else self._submit(image, owner, _segmentation, segment=True)

    def graph(self, view_id: str) -> bytes:
        """The context graph of a view, drawn over the photo; raises NotFound, Busy."""
        owner, image = self._source(view_id)
        return self.draw_graph(image, owner)

    def draw_overlay(self, image: Image, owner: MapRecord) -> bytes:
        """An image with its labels by a map's recipe blended over it, dynamic cells grey, as PNG; raises Busy."""
        return self._submit(image, owner, _overlay, segment=True)

    def draw_graph(self, image: Image, owner: MapRecord) -> bytes:
        """An image with its context graph by a map's recipe drawn over it, as PNG; raises Busy."""
        return self._submit(image, owner, _graph, segment=False)

    def explanation(self, query_id: str, view_id: str | None) -> bytes:
        """Query and view side by side with their correspondences, as PNG; raises NotFound."""
        explained = self._explanations.get(query_id)
        scored = explained.view(view_id)
        return explained.draw(scored, self._decode(self._views.image(scored.view.id)))

    def version(self, view_id: str, kind: str) -> str:
        """A version of an image made from a view, for an ETag; `kind` names the image and its options."""
        record = self._views.get(view_id)
        if kind.startswith(("image", "thumbnail")):
            return f"{record.image.sha256[:24]}-{kind}"
        owner = self._maps.get(record.map)
        ranked = f"-{owner.ranking.id}" if kind.startswith("graph") else ""  # the ranking limits the length of edges
        return f"{record.id}-{owner.description.id}{ranked}-{kind}"

    def _source(self, view_id: str) -> tuple[MapRecord, Image]:
        owner = self._maps.get(self._views.get(view_id).map)
        return owner, self._decode(self._views.image(view_id))

    def _submit(self, image: Image, owner: MapRecord, draw: Draw, *, segment: bool) -> bytes:
        describer = self._describers.of(owner.description)

        def finish(image: Image, field: PixelField) -> bytes:
            return draw(image, field, describer, owner)

        return self._scheduler.submit(image, finish, urgent=True, segment=segment).result().value


def _segmentation(image: Image, field: PixelField, describer: Describer, owner: MapRecord) -> bytes:
    segmentation = describer.segment(field)
    return drawing.segmentation_png(segmentation.labels, (image.width, image.height), owner.description.labels)


def _overlay(image: Image, field: PixelField, describer: Describer, owner: MapRecord) -> bytes:
    segmentation = describer.segment(field)
    return drawing.overlay_png(image.pixels, segmentation.labels, owner.description.labels, segmentation.static)


def _graph(image: Image, field: PixelField, describer: Describer, owner: MapRecord) -> bytes:
    graph = describer.graph(field, describer.segment(field))
    return drawing.graph_png(image.pixels, graph, owner.description.labels, owner.ranking.graph_max_edge)
