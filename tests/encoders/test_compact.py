"""The built-in encoder in ONNX Runtime: it answers as torch does, whatever the size, the threads and the neighbours."""

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from scenes import scene
from schemas.description import Floats
from schemas.errors import SetupError
from schemas.image import Bytes2D, Image
from schemas.settings import Settings
from worker.configure import configure_torch
from worker.encoders.choosing import make_encoder
from worker.encoders.compact.encoder import WEIGHTS, CompactEncoder
from worker.encoders.compact.ensemble import (
    ENSEMBLE,
    CompactSegmenter,
    label_confidence,
    prepared,
    segment_with_ensemble,
)
from worker.encoders.compact.input_size import LONGEST, MULTIPLE, resized
from worker.encoders.compact.onnx import OnnxEngine
from worker.encoders.compact.torch import TorchEngine

ROOT = Path(__file__).parents[2]
SIZES = [(640, 480), (300, 300), (200, 900), (1241, 376), (96, 64)]
"""Width and height of pictures."""

MEMBERS = [WEIGHTS.with_name(f"compact-{member}.safetensors") for member in ENSEMBLE]
FILES = tuple(path.name for weights in (WEIGHTS, *MEMBERS) for path in (weights, weights.with_suffix(".onnx")))


def without(weights: Path, *members: str) -> CompactEncoder:
    described = weights.with_suffix(".json")
    facts = json.loads(described.read_text())
    described.write_text(json.dumps({name: fact for name, fact in facts.items() if name not in members}))
    return CompactEncoder(weights=weights)


def segmenter(encoder: CompactEncoder) -> CompactSegmenter:
    found = encoder.segmenter()
    assert found is not None
    return found


def drawn(width: int, height: int) -> Image:
    return Image.of(scene("town", "street").sized(width, height).pixels)


def cosines(one: Floats, other: Floats) -> Floats:
    product: Floats = (one * other).sum(axis=-1)
    return product


def in_onnx(threads: int = 1) -> OnnxEngine:
    return OnnxEngine(WEIGHTS.with_suffix(".onnx"), [path.with_suffix(".onnx") for path in MEMBERS], threads=threads)


@pytest.fixture(scope="module")
def encoder() -> CompactEncoder:
    return CompactEncoder()


@pytest.fixture(scope="module")
def engine() -> OnnxEngine:
    return in_onnx()


@pytest.fixture(scope="module")
def reference() -> TorchEngine:
    torch.set_num_threads(1)
    return TorchEngine(WEIGHTS.read_bytes(), [path.read_bytes() for path in MEMBERS], "cpu")


@pytest.fixture(scope="module")
def on_gpu() -> CompactEncoder:
    return CompactEncoder("cuda")


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """The shipped files where they can be spoilt."""
    for name in ("compact.json", *FILES):
        shutil.copy(WEIGHTS.with_name(name), tmp_path)
    return tmp_path / WEIGHTS.name


@pytest.fixture(scope="module", params=SIZES, ids="{0[0]}x{0[1]}".format)
def layers(
    encoder: CompactEncoder, engine: OnnxEngine, reference: TorchEngine, request: pytest.FixtureRequest
) -> list[tuple[Floats, Floats]]:
    """Detail, meaning and what each member of the ensemble sees in an image of each size, in ONNX Runtime and torch."""
    image = drawn(*request.param)
    pixels = resized(image.pixels)[None]
    [field] = encoder.encode([image])
    semantic, detail = reference.fields(pixels)
    return [
        (field.layers["detail"], detail[0]),
        (field.semantic, semantic[0]),
        *((engine.segment(pixels, member)[0], reference.segment(pixels, member)[0]) for member in range(3)),
    ]


class TestParity:
    def test_every_cell_is_as_torch_has_it(self, layers: list[tuple[Floats, Floats]]) -> None:
        for mine, other in layers:
            assert mine.shape == other.shape
            assert cosines(mine, other).min() > 0.9999
            assert np.abs(np.linalg.norm(mine, axis=-1) - 1).max() < 1e-5

    def test_every_cell_takes_the_label_that_it_takes_in_torch(
        self, encoder: CompactEncoder, layers: list[tuple[Floats, Floats]]
    ) -> None:
        text = encoder.text_vectors(["road", "sidewalk", "building", "car", "vegetation", "sky", "person", "pole"])

        for mine, other in layers[1:]:  # the first one is no meaning
            first, second = np.sort(other @ text.T, axis=-1)[..., :-3:-1].transpose(2, 0, 1)
            certain = first - second > 1e-4  # two labels as near as that may change places by rounding
            assert certain.mean() > 0.98
            assert np.array_equal((mine @ text.T).argmax(-1)[certain], (other @ text.T).argmax(-1)[certain])

    def test_on_another_device_runs_of_one_size_go_together_and_keep_their_order(self, encoder: CompactEncoder) -> None:
        images = [drawn(*size) for size in ((900, 200), (450, 100), (200, 900), (900, 200))]
        in_torch = CompactEncoder("cpu:0")  # anything but "cpu" means torch, and batches
        by_onnx, by_torch = segmenter(encoder), segmenter(in_torch)

        for mine, other in zip(encoder.encode(images), in_torch.encode(images), strict=True):
            assert cosines(mine.semantic, other.semantic).min() > 0.9999
        for image in images[:2]:
            assert cosines(by_onnx.segment(image).semantic, by_torch.segment(image).semantic).min() > 0.9999


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
class TestOnAGpu:
    """A map that a GPU described is queried on a CPU, and the other way round."""

    def test_every_cell_is_as_on_a_cpu(self, encoder: CompactEncoder, on_gpu: CompactEncoder) -> None:
        images = [drawn(*size) for size in SIZES for _ in range(3)]

        for mine, other in zip(encoder.encode(images), on_gpu.encode(images), strict=True):
            assert cosines(mine.semantic, other.semantic).min() > 0.9999
            assert cosines(mine.layers["detail"], other.layers["detail"]).min() > 0.9999

    def test_segmentations_are_as_on_a_cpu(self, encoder: CompactEncoder, on_gpu: CompactEncoder) -> None:
        for size in SIZES[:2]:
            image = drawn(*size)
            assert (
                cosines(segmenter(encoder).segment(image).semantic, segmenter(on_gpu).segment(image).semantic).min()
                > 0.9999
            )

    def test_neighbours_in_a_batch_change_rounding_alone(self, on_gpu: CompactEncoder) -> None:
        image, other = drawn(640, 480), Image.of(np.zeros((480, 640, 3), np.uint8))
        [alone] = on_gpu.encode([image])
        together = list(on_gpu.encode([other, image, *[other] * 6]))[1]

        assert cosines(alone.semantic, together.semantic).min() > 0.99999
        assert cosines(alone.layers["detail"], together.layers["detail"]).min() > 0.99999


class TestIndependence:
    def test_an_image_does_not_depend_on_its_neighbours(self, encoder: CompactEncoder) -> None:
        images = [drawn(*size) for size in SIZES]

        together = [field.semantic for field in encoder.encode(images)]

        for image, field in zip(images, together, strict=True):
            assert np.array_equal(next(encoder.encode([image])).semantic, field)

    def test_nor_on_the_number_of_threads(self, encoder: CompactEncoder) -> None:
        image = drawn(640, 480)

        [one], [several] = encoder.encode([image]), CompactEncoder(threads=3).encode([image])

        assert np.array_equal(one.semantic, several.semantic)
        assert np.array_equal(one.layers["detail"], several.layers["detail"])

    def test_nor_on_what_shares_its_batch(self) -> None:
        engine = in_onnx(threads=2)
        pixels = resized(drawn(640, 480).pixels)

        alone, among = engine.fields(pixels[None]), engine.fields(np.stack([255 - pixels, pixels, pixels // 2]))

        for one, several in zip(alone, among, strict=True):
            assert np.array_equal(one[0], several[1])

    def test_memory_does_not_grow_with_every_new_size(self, encoder: CompactEncoder) -> None:
        sides = range(96, LONGEST + 1, MULTIPLE)
        sizes = [(LONGEST, side) for side in sides] + [(side, LONGEST) for side in sides]

        def resident_mb() -> float:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            return pages * 4096 / 1e6

        if not Path("/proc/self/statm").exists():
            pytest.skip("NOT RUN: only Linux says how much memory a process has")
        largest = Image.of(np.zeros((LONGEST, LONGEST, 3), np.uint8))
        list(encoder.encode([largest]))
        before = resident_mb()
        for width, height in sizes:
            list(encoder.encode([Image.of(np.zeros((height, width, 3), np.uint8))]))
        assert resident_mb() < before + 60


class TestSegmenter:
    def test_it_mostly_says_the_same_at_twice_the_resolution(self, encoder: CompactEncoder) -> None:
        image = drawn(640, 480)
        text = encoder.text_vectors(["road", "building", "car", "vegetation", "sky"])

        coarse, fine = next(encoder.encode([image])), segmenter(encoder).segment(image)

        assert fine.extent == coarse.extent
        assert fine.shape == (2 * coarse.shape[0], 2 * coarse.shape[1])
        enlarged = coarse.semantic.repeat(2, axis=0).repeat(2, axis=1)
        same = (fine.semantic @ text.T).argmax(-1) == (enlarged @ text.T).argmax(-1)
        assert float(same.mean()) > 0.7

    def test_an_image_and_its_mirror_image_mostly_show_the_same(self, encoder: CompactEncoder) -> None:
        image = drawn(480, 352)
        mirrored = Image.of(np.ascontiguousarray(image.pixels[:, ::-1]))
        text = encoder.text_vectors(["road", "building", "car", "vegetation", "sky"])

        one, other = (segmenter(encoder).segment(shown).semantic for shown in (image, mirrored))

        same = (one @ text.T).argmax(-1) == (other[:, ::-1] @ text.T).argmax(-1)
        assert float(same.mean()) > 0.8
        assert np.abs(np.linalg.norm(one, axis=-1) - 1).max() < 1e-5

    def test_it_is_the_mean_of_mirrored_augmentations_and_larger_ones(self) -> None:
        image = drawn(960, 704)
        sizes = []

        # Channels: where the cell lies across the view, and how large that is.
        def segment(seen: Bytes2D, member: int) -> Floats:
            sizes.append((member, *seen.shape[:2]))
            rows, columns = seen.shape[0] // 4, seen.shape[1] // 4
            across = np.broadcast_to((np.arange(columns) + 0.5) / columns, (rows, columns))
            return np.stack([across, np.full_like(across, columns / 120)], axis=2).astype(np.float32)

        seen = segment_with_ensemble(prepared(image, 3), segment, np.eye(2, dtype=np.float32)[1:] * 0, 3)

        assert sizes == [
            *((0, 256, 352), (0, 448, 608)),
            *((1, 448, 608), (1, 512, 704)),
            *((2, 448, 608), (2, 512, 704)),
        ]
        assert seen.shape == (88, 120, 2)
        # A mirrored 1 - x and a plain x: half way everywhere but at the border, where interpolation ends.
        expected = np.array([1.0 + 2.8, (88 + 152 + 2.8 * (152 + 176)) / 120])
        np.testing.assert_allclose(
            seen[:, 4:-4], np.broadcast_to(expected / np.linalg.norm(expected), (88, 112, 2)), atol=1e-3
        )

    def test_a_member_that_is_near_no_label_counts_for_little(self) -> None:
        label, nothing = np.eye(2, dtype=np.float32)

        def segment(seen: Bytes2D, member: int) -> Floats:
            at = label if member == 0 else 0.5 * label + np.sqrt(0.75) * nothing
            return np.broadcast_to(at, (seen.shape[0] // 4, seen.shape[1] // 4, 2)).astype(np.float32)

        seen = segment_with_ensemble(prepared(drawn(960, 704), 3), segment, label[None], 3)

        assert label_confidence(segment(np.zeros((32, 32, 3), np.uint8), 1), label[None]) == pytest.approx(0.5)
        expected = 2 * label + 4 * 1.4 * 0.5**6 * (0.5 * label + np.sqrt(0.75) * nothing)
        np.testing.assert_allclose(seen[0, 0], expected / np.linalg.norm(expected), atol=1e-4)

    def test_without_any_member_there_is_no_segmenter(self, copied: Path) -> None:
        assert without(copied, *ENSEMBLE).segmenter() is None

    @pytest.mark.parametrize("members", [1, 2])
    def test_without_a_later_member_those_before_it_are_believed(
        self, encoder: CompactEncoder, engine: OnnxEngine, copied: Path, members: int
    ) -> None:
        image = drawn(900, 200)

        believed = segmenter(without(copied, ENSEMBLE[members])).segment(image).semantic

        vectors = load_file(WEIGHTS)["text.vectors"].astype(np.float32)
        expected = segment_with_ensemble(
            prepared(image, members), lambda seen, member: engine.segment(seen[None], member)[0], vectors, members
        )
        assert np.array_equal(believed, expected)
        assert not np.array_equal(believed, segmenter(encoder).segment(image).semantic)


class TestFiles:
    def test_the_engine_on_a_cpu_does_without_torch(self) -> None:
        command = (
            "import sys; from worker.encoders.choosing import make_encoder; from schemas.settings import Settings; "
            "make_encoder(Settings(), 1); print('torch' in sys.modules, 'onnxruntime' in sys.modules)"
        )
        loaded = subprocess.run([sys.executable, "-c", command], cwd=ROOT, capture_output=True, text=True, check=True)
        assert loaded.stdout.split() == ["False", "True"]

    @pytest.mark.parametrize("name", ["compact.json", *FILES])
    def test_a_missing_file_is_named(self, copied: Path, name: str) -> None:
        copied.with_name(name).unlink()

        with pytest.raises(SetupError, match=name):
            CompactEncoder(weights=copied)

    @pytest.mark.parametrize("name", FILES)
    def test_a_changed_file_is_refused(self, copied: Path, name: str) -> None:
        with copied.with_name(name).open("ab") as file:
            file.write(b"\0")

        with pytest.raises(SetupError, match=f"{name} has the SHA-256"):
            CompactEncoder(weights=copied)

    def test_weights_without_a_graph_are_refused(self, copied: Path) -> None:
        described = copied.with_suffix(".json")
        facts = json.loads(described.read_text())
        del facts["graph"]
        described.write_text(json.dumps(facts))

        with pytest.raises(SetupError, match="names no graph"):
            CompactEncoder(weights=copied)

    def test_a_graph_that_cannot_be_loaded_is_told(self, copied: Path) -> None:
        described = copied.with_suffix(".json")
        facts = json.loads(described.read_text())
        copied.with_suffix(".onnx").write_bytes(b"no graph")
        facts["graph"]["sha256"] = hashlib.sha256(b"no graph").hexdigest()
        described.write_text(json.dumps(facts))

        with pytest.raises(SetupError, match=r"cannot load compact\.onnx"):
            CompactEncoder(weights=copied)

    @pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
    def test_a_gpu_that_is_not_there_is_told(self) -> None:
        with pytest.raises(SetupError, match=r"no CUDA device was found.*REVISIT_DEVICE=cpu"):
            make_encoder(Settings(device="cuda"), 1)

    @pytest.mark.parametrize(
        ("device", "cuda", "count", "told"),
        [
            ("cuda", None, 0, "./revisit --gpu set-up"),
            ("cuda", "13.0", 0, "--gpus all"),
            ("cuda:3", "13.0", 2, "the last CUDA device here is cuda:1"),
            ("cuda:", "13.0", 2, "it is cpu, cuda, or cuda:1"),
            ("gpu", "13.0", 2, "it is cpu, cuda, or cuda:1"),
        ],
    )
    def test_what_to_do_about_a_gpu_is_told(
        self, device: str, cuda: str | None, count: int, told: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("torch.version.cuda", cuda)
        monkeypatch.setattr("torch.version.hip", None)
        monkeypatch.setattr("torch.cuda.is_available", lambda: count > 0)
        monkeypatch.setattr("torch.cuda.device_count", lambda: count)

        with pytest.raises(SetupError) as refused:
            configure_torch(1, device)
        assert f"REVISIT_DEVICE={device}" in str(refused.value)
        assert told in str(refused.value)

    def test_without_onnx_runtime_it_says_so_and_does_not_fall_back(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "onnxruntime", None)

        with pytest.raises(SetupError, match="install the package onnxruntime"):
            CompactEncoder()
