"""Drawings are right to the pixel where programs read them, and show what they should where people look."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image as PilImage

from schemas.description import ContextGraph
from worker.images import drawing
from worker.images.palette import colour

LABELS = ("sky", "building", "car")


def decoded(png: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert image is not None
    return np.asarray(image)


def graph(*nodes: tuple[int, float, float, float]) -> ContextGraph:
    labels, xs, ys, shares = zip(*nodes, strict=True)
    return ContextGraph(
        np.array(labels, np.int16),
        np.stack([xs, ys], axis=1).astype(np.float32),
        np.ones((len(nodes), 2), np.float32),
        np.array(shares, np.float32),
    )


def test_a_segmentation_has_the_size_of_the_image_and_labels_as_values() -> None:
    labels = np.array([[0, 0, 1], [2, 1, 1]], np.int16)

    image = PilImage.open(io.BytesIO(drawing.segmentation_png(labels, (30, 20), LABELS)))

    assert (image.mode, image.size) == ("P", (30, 20))
    values = np.asarray(image)
    assert values[0, 0] == 0
    assert values[19, 0] == 2
    assert values[10, 29] == 1
    np.testing.assert_array_equal(values[5::10, 5::10], labels)


def test_the_palette_gives_each_label_the_colour_that_the_map_names_and_no_transparency() -> None:
    image = PilImage.open(io.BytesIO(drawing.segmentation_png(np.array([[2]]), (4, 4), LABELS)))

    assert "transparency" not in image.info
    assert image.convert("RGB").getpixel((0, 0)) == colour("car")


def test_the_image_may_have_any_size() -> None:
    image = PilImage.open(io.BytesIO(drawing.segmentation_png(np.zeros((60, 80), np.int16), (33, 41), LABELS)))

    assert image.size == (33, 41)


def test_an_overlay_greys_what_moves_and_colours_the_rest() -> None:
    pixels = np.full((48, 64, 3), (200, 40, 40), np.uint8)
    labels = np.array([[0, 2]], np.int16)

    image = decoded(drawing.overlay_png(pixels, labels, LABELS, np.array([[True, False]])))

    assert image.shape[0] > 48  # the key is below
    assert image.shape[1] == 64
    moving, still = image[20, 50].astype(int), image[20, 10].astype(int)
    assert np.ptp(moving) <= 2
    np.testing.assert_allclose(still, 0.55 * pixels[0, 0] + 0.45 * np.array(colour("sky")), atol=2)


def test_a_graph_draws_its_nodes_and_only_short_edges() -> None:
    pixels = np.full((480, 640, 3), 90, np.uint8)
    three = graph((0, 0.2, 0.3, 0.01), (1, 0.4, 0.3, 0.01), (1, 0.9, 0.3, 0.01))

    image = decoded(drawing.graph_png(pixels, three, LABELS, tau=0.25))

    assert tuple(image[192, 128]) == colour("sky")
    assert tuple(image[192, 576]) == colour("building")
    background = image[400, 320]
    assert (image[192, 192] != background).any()  # the edge between the first two
    np.testing.assert_array_equal(image[192, 416], background)  # none to the third


@pytest.mark.parametrize("nodes", [0, 1])
def test_graphs_without_edges_can_be_drawn(nodes: int) -> None:
    empty = ContextGraph(
        np.zeros(nodes, np.int16),
        np.full((nodes, 2), 0.5, np.float32),
        np.zeros((nodes, 2), np.float32),
        np.zeros(nodes, np.float32),
    )

    assert decoded(drawing.graph_png(np.zeros((40, 50, 3), np.uint8), empty, LABELS, 0.1)).shape == (40, 50, 3)


def test_an_explanation_joins_what_agrees_across_images_of_different_sizes() -> None:
    query, view = np.full((60, 80, 3), 120, np.uint8), np.full((200, 150, 3), 120, np.uint8)

    plain = decoded(drawing.explanation_png(query, view, [], [], ["score 0.8"]))
    joined = decoded(
        drawing.explanation_png(
            query, view, [((0.5, 0.4), (0.3, 0.5))], [("sky", (0.1, 0.1), (0.2, 0.2))], ["score 0.8"]
        )
    )

    assert plain.shape == joined.shape
    assert plain.shape[1] == 640 + 12 + 360
    assert (plain[200:300, 642:650] != joined[200:300, 642:650]).any()  # a line crosses the gap
    assert (plain[485:] < 100).any()  # the text
