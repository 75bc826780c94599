"""Image to description: the method's steps on a pixel field, in the paper's order."""

from concurrent.futures import Future
from dataclasses import dataclass

import cv2
import numpy as np

from schemas.description import (
    SEMANTIC,
    Appearance,
    Booleans,
    ContextGraph,
    Description,
    Floats,
    LocalFeatures,
    PixelField,
)
from schemas.errors import NothingStatic
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from worker.description.local_features import local_features
from worker.description.ports import Encoder
from worker.description.scheduler import Scheduler, Timed
from worker.description.vocabularies import Vocabulary
from worker.method import context_graph, dense_cells, labels, sampling, static_mask, vocabulary
from worker.method.byte_vectors import Product, float_product, quantise
from worker.method.context_graph import Regions
from worker.method.lost_cells import PhotoCells


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Label of each cell of an image, and which cells are static.

    Parameters
    ----------
    labels : int16 of shape (rows, columns)
        Index into the recipe's labels.
    static : bool of shape (rows, columns)
    """

    labels: labels.LabelMap
    static: Booleans


class Describer:
    """Describes images by one recipe. Stateless: the order of the images does not matter.

    Parameters
    ----------
    encoder : Encoder
        Made the fields; only its text vectors are used here.
    recipe : DescriptionRecipe
    vocabulary : Vocabulary
        The one that the recipe names.
    product : Product
        Multiplies descriptors with visual words.
    """

    def __init__(
        self, encoder: Encoder, recipe: DescriptionRecipe, vocabulary: Vocabulary, product: Product = float_product
    ) -> None:
        self.recipe = recipe
        self.vocabulary = vocabulary
        self._product = product
        self._text = encoder.text_vectors(recipe.labels)
        self._dynamic = np.isin(np.array(recipe.labels), np.array(recipe.dynamic))

    def segment(self, field: PixelField) -> Segmentation:
        """Label map and static cells of a pixel field."""
        parameters = self.recipe.parameters.dynamic
        scores = labels.scores(field.semantic, self._text)
        static = static_mask.static_cells(scores, self._dynamic, parameters.margin, parameters.most)
        return Segmentation(labels.label_map(scores), static)

    def graph(self, field: PixelField, segmentation: Segmentation) -> ContextGraph:
        """The context graph of a pixel field."""
        least = self.recipe.parameters.graph.min_region_cells
        return context_graph.build(
            segmentation.labels, segmentation.static, field.semantic, field.extent, components, least
        )

    def photo_cells(self, field: PixelField, segmented: PixelField) -> PhotoCells:
        """The cells of an image in which changes are looked for; labels come from `segmented`, which may be finer.

        A cell whose best label is dynamic is left out whatever the margin of the recipe, so that nothing that moves
        counts as a change.
        """
        rows, columns = field.shape
        layers = {name: dense_cells.grid(layer, rows, columns) for name, layer in field.layers.items()}
        scores = labels.scores(dense_cells.average(segmented.layers[SEMANTIC], rows, columns), self._text)
        static = static_mask.static_cells(scores, self._dynamic)
        return PhotoCells(dense_cells.join(layers, {}), scores, static, field.extent)

    def keypoints(self, image: Image) -> LocalFeatures | None:
        """Local features for verification; None when the recipe has none. They do not need the pixel field."""
        wanted = self.recipe.parameters
        if wanted.local_features is None:
            return None
        side, equalised = wanted.local_features_side, wanted.local_features_equalised
        return local_features(image.pixels, wanted.local_features, side, equalised)

    def submit(self, scheduler: Scheduler, image: Image, *, urgent: bool) -> "Future[Timed[Description]]":
        """Queue an image to be described: its field is encoded while its local features are found.

        Parameters
        ----------
        scheduler : Scheduler
            Of the describer's encoder.
        image : Image
        urgent : bool
            True for queries, False for enrolments.

        Raises
        ------
        Busy, Unavailable
            As `Scheduler.submit`.
        """
        return scheduler.submit(image, self.describe, urgent=urgent, parallel=self.keypoints)

    def describe(self, image: Image, field: PixelField, found: LocalFeatures | None) -> Description:
        """The description of an image by the recipe; `found` are the local features from `keypoints`.

        Raises
        ------
        NothingStatic
            Every cell is dynamic.
        """
        parameters = self.recipe.parameters
        segmentation = self.segment(field)
        if not segmentation.static.any():
            shown = ", ".join(self.recipe.labels[i] for i in np.unique(segmentation.labels))
            raise NothingStatic(f"every part of the image is something that moves ({shown}); show more of the place")
        random = sampling.generator(parameters.seed, image.digest)
        vectors: dict[str, Floats] = {}
        parts: dict[str, Floats] = {}
        count = 0
        for name, channel in parameters.channels.items():
            layer = field.layers[channel.layer]
            drawn = sampling.draw(segmentation.static, channel.descriptors, random)
            count = max(count, len(drawn))
            descriptors = layer.reshape(-1, layer.shape[2])[drawn]
            learned = self.vocabulary.channels[name]
            vectors[name] = vocabulary.vector(descriptors, learned, channel, self._product)
            if parameters.dense is not None and learned.cells is not None:
                grid = dense_cells.grid(layer, parameters.dense.rows, parameters.dense.columns)
                parts[name] = dense_cells.reduce(grid, learned.cells)
        cells = quantise(dense_cells.join(parts, parameters.dense.channel_weights if parameters.dense else {}))
        return Description(
            vectors=vectors,
            appearance=Appearance(quantise(dense_cells.halve(cells)), self.graph(field, segmentation), field.extent),
            cells=cells,
            keypoints=found,
            label_shares=labels.shares(segmentation.labels, len(self.recipe.labels)),
            static_share=float(segmentation.static.mean()),
            descriptor_count=count,
        )


def components(mask: Booleans) -> Regions:
    """8-connected components; see `context_graph.Components`."""
    numbered: Regions = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]
    return numbered
