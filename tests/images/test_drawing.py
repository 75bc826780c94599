"""Drawings are right to the pixel where programs read them, and show what they should where people look."""

import io
import time
import tracemalloc

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

    image = decoded(drawing.overlay_png(pixels, labels, LABELS, np.array([[True, False]]), legend=True))

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


@pytest.mark.parametrize("size", [(48, 64), (333, 17), (5, 700)])
def test_a_drawing_is_as_large_as_the_photo_unless_a_legend_is_wanted(size: tuple[int, int]) -> None:
    pixels = np.full((*size, 3), 120, np.uint8)
    labels, static = np.array([[0, 1]], np.int16), np.array([[True, True]])
    two = graph((0, 0.2, 0.3, 0.5), (1, 0.4, 0.3, 0.5))

    overlay = drawing.overlay_png(pixels, labels, LABELS, static, caption="not drawn")
    nodes = drawing.graph_png(pixels, two, LABELS, 0.3, caption="not drawn")
    assert decoded(overlay).shape == decoded(nodes).shape == (*size, 3)

    for drawn, plain in (
        (drawing.overlay_png(pixels, labels, LABELS, static, legend=True), overlay),
        (drawing.graph_png(pixels, two, LABELS, 0.3, legend=True), nodes),
    ):
        both = decoded(drawn)
        assert both.shape[0] > size[0]
        assert both.shape[1] == size[1]
        np.testing.assert_array_equal(both[: size[0]], decoded(plain))


def test_a_caption_stands_below_the_legend() -> None:
    pixels, labels, static = np.full((480, 640, 3), 120, np.uint8), np.array([[0]]), np.array([[True]])

    plain = decoded(drawing.overlay_png(pixels, labels, LABELS, static, legend=True))
    told = decoded(drawing.overlay_png(pixels, labels, LABELS, static, legend=True, caption="by another network"))

    assert told.shape[0] > plain.shape[0]
    assert (told[plain.shape[0] :] < 100).any()


def test_a_legend_leaves_out_labels_of_specks() -> None:
    labels = np.zeros((20, 20), np.int16)
    labels[0, :3] = 1
    pixels, static = np.full((400, 400, 3), 120, np.uint8), np.ones((20, 20), bool)

    speck = decoded(drawing.overlay_png(pixels, labels, LABELS, static, legend=True))
    labels[0, 3] = 1
    one_per_cent = decoded(drawing.overlay_png(pixels, labels, LABELS, static, legend=True))

    assert not (speck[400:] == colour("building")).all(axis=2).any()
    assert (one_per_cent[400:] == colour("building")).all(axis=2).any()


def test_a_graph_leaves_out_what_moves_and_specks() -> None:
    pixels = np.full((480, 640, 3), 90, np.uint8)
    nodes = graph((0, 0.2, 0.3, 0.01), (1, 0.4, 0.3, 0.0099), (2, 0.6, 0.3, 0.2))

    image = decoded(drawing.graph_png(pixels, nodes, LABELS, 0.3, dynamic=("car",), legend=True))

    assert tuple(image[192, 128]) == colour("sky")
    background = image[400, 320]
    np.testing.assert_array_equal(image[192, 256], background)
    np.testing.assert_array_equal(image[192, 384], background)
    np.testing.assert_array_equal(image[192, 192], background)  # nor edges to what is left out
    key = image[480:]
    assert (key == colour("sky")).all(axis=2).any()
    assert not (key == colour("car")).all(axis=2).any()


@pytest.mark.parametrize("size", [(400, 20_000), (20_000, 400), (1600, 32), (32, 1600)])
def test_what_is_drawn_over_the_narrowest_images_fits_them(size: tuple[int, int]) -> None:
    pixels = np.full((*size, 3), 120, np.uint8)
    labels = np.arange(12).reshape(3, 4) % 3
    wide, high = size[1] / max(size), size[0] / max(size)
    many = graph(*((number % 3, wide * number / 12, high * number / 12, 1 / 12) for number in range(12)))
    caption = "a caption that is longer than the narrowest of images, and is wrapped or shortened"
    begin = time.perf_counter()

    with_keys = (
        drawing.overlay_png(pixels, labels, LABELS, np.ones((3, 4), bool), legend=True, caption=caption),
        drawing.graph_png(pixels, many, LABELS, 0.5, legend=True, caption=caption),
    )

    assert time.perf_counter() - begin < 60  # was minutes for fonts as large as the image
    for png in with_keys:
        image = decoded(png)
        assert image.shape[1] == size[1]
        assert size[0] < image.shape[0] <= size[0] + max(200, size[1])  # the key is no larger than the image


@pytest.mark.parametrize("size", [(480, 640), (800, 3200), (3000, 4000)])
def test_sizes_of_what_is_drawn_follow_the_longer_side(size: tuple[int, int]) -> None:
    pixels, labels = np.full((*size, 3), 120, np.uint8), np.zeros((1, 1), np.int16)

    keyed = decoded(drawing.overlay_png(pixels, labels, LABELS, np.ones((1, 1), bool), legend=True))

    line = round(20 * max(size) / 640)
    assert keyed.shape[0] == size[0] + line + line // 3


def test_rows_are_blended_as_in_one_piece_and_take_less_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(5)
    pixels = chance.integers(0, 256, (1500, 2000, 3), np.uint8)
    labels, static = chance.integers(0, 3, (37, 50)), chance.random((37, 50)) < 0.7
    nodes = graph((0, 0.2, 0.3, 0.5), (1, 0.4, 0.3, 0.5))

    def both() -> tuple[bytes, bytes]:
        overlay = drawing.overlay_png(pixels, labels, LABELS, static, legend=True)
        return overlay, drawing.graph_png(pixels, nodes, LABELS, 0.3)

    tracemalloc.start()
    in_parts = both()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    monkeypatch.setattr(drawing, "ROWS_AT_ONCE", 10_000)

    assert both() == in_parts
    assert most < 8 * pixels.nbytes  # as floats the photo alone takes four times itself, and there were several
