"""The whole network, with random weights in the published layout, against outputs of the original program.

Bars are those of the data's README: for float32 on a CPU. They see every geometric slip at once; the constants that
they can hardly see (the LayerNorm's epsilon, the GELU's kind) are what `test_network` is for.
"""

import functools
import importlib.util
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor, nn

from schemas.image import Image
from worker.encoders.lseg.encoder import LsegEncoder
from worker.encoders.lseg.tokenizer import Tokenizer

pytestmark = [pytest.mark.shared, pytest.mark.slow]

MEMORY_NEEDED = 6e9
"""Bytes: the maker of the checkpoint and the encoder take up to 3 GB each, and the file should stay in the cache."""

CASES = ["wide", "small", "tall"]

Expected = dict[str, npt.NDArray[np.generic]]


@pytest.fixture(scope="module")
def parity(shared: Path) -> Path:
    folder = shared / "lseg-parity"
    if not folder.is_dir():
        pytest.skip(f"NOT RUN: needs the parity set of LSeg, and there is none at {folder}")
    free = available_memory()
    if free < MEMORY_NEEDED:
        pytest.skip(f"NOT RUN: needs {MEMORY_NEEDED / 1e9:.0f} GB of free memory, and there are {free / 1e9:.1f}")
    if importlib.util.find_spec("clip") is None and importlib.util.find_spec("open_clip") is None:
        pytest.skip("NOT RUN: needs CLIP's vocabulary; install the extra lseg")
    return folder


def available_memory() -> float:
    """Bytes that can be had without swapping; on systems that do not tell, all there are."""
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        lines = dict(line.split(":", 1) for line in meminfo.read_text().splitlines())
        return 1024.0 * int(lines["MemAvailable"].split()[0])
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


@pytest.fixture(scope="module")
def expected(parity: Path) -> Expected:
    with np.load(parity / "expected.npz") as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def encoder(parity: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LsegEncoder]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # two take half as much time again of the processor, while other tests run beside
    file = tmp_path_factory.mktemp("lseg") / "random.ckpt"
    assert script(parity / "make_random_checkpoint.py").main([str(file), "--hparams"]) == 0
    yield LsegEncoder.open(file)
    file.unlink()  # 1.7 GB
    torch.set_num_threads(threads)


def script(path: Path) -> ModuleType:
    """A Python file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Trace:
    """What the named layers put out the first time they run.

    Kept at four places each: tokens 0, 1, 451 and 900 of a block, and corners and inner cells of a map.
    """

    def __init__(self, encoder: LsegEncoder) -> None:
        network = encoder._network
        blocks = {f"block{i}": f"pretrained.model.blocks.{i}" for i in (0, 5, 11, 17, 23)}
        steps = [f"layer{i}_rn" for i in range(1, 5)] + [f"refinenet{i}" for i in range(1, 5)] + ["head1"]
        layers = {**blocks, **{name: f"scratch.{name}" for name in steps}}
        self.values: dict[str, Tensor] = {}
        self.statistics: dict[str, tuple[float, float]] = {}
        self.sizes: dict[str, tuple[int, ...]] = {}
        self._hooks = [
            network.get_submodule(layer).register_forward_hook(functools.partial(self._keep, name))
            for name, layer in layers.items()
        ]

    def _keep(self, name: str, _layer: nn.Module, _inputs: object, output: Tensor) -> None:
        if name in self.values:
            return
        first = output[0]
        if name.startswith("block"):
            places = first[[0, 1, 451, 900]]
        else:
            height, width = first.shape[1:]
            rows = [0, height // 3, height // 2, height - 1]
            places = first[:, rows, [0, width // 2, width // 5, width - 1]].T
        self.values[name] = places[:, :8].clone()
        self.statistics[name] = (first.mean().item(), first.std().item())
        self.sizes[name] = tuple(first.shape)

    def close(self) -> None:
        for hook in self._hooks:
            hook.remove()


@dataclass(frozen=True)
class Run:
    """One picture through the encoder, reduced to what is compared."""

    grid: tuple[int, int]
    embeddings: npt.NDArray[np.float32]
    labels: npt.NDArray[np.int64]
    trace: Trace


@pytest.fixture(scope="module")
def runs(encoder: LsegEncoder, expected: Expected, parity: Path) -> "functools._lru_cache_wrapper[Run]":
    """Each case is run once, whichever test asks first."""
    draw = vars(script(parity / "test_pictures.py"))["picture"]  # its own name for an image
    words = torch.from_numpy(expected["text_features"][expected["label_word_index"]])

    @functools.cache
    def run(case: str) -> Run:
        trace = Trace(encoder)
        raw = next(encoder.raw([Image.of(draw(case))]))
        trace.close()
        rows, columns = torch.from_numpy(expected[f"{case}_positions"].astype(np.int64)).T
        labels = torch.cat([(row @ words.T).argmax(-1)[None] for row in raw])
        return Run((raw.shape[0], raw.shape[1]), raw[rows, columns].numpy(), labels.numpy(), trace)

    return run


def test_the_weights_are_those_of_the_expected_outputs(parity: Path, expected: Expected) -> None:
    assert int(expected["seed"]) == script(parity / "make_random_checkpoint.py").DEFAULT_SEED


def test_token_ids(expected: Expected) -> None:
    encode = Tokenizer.read(None, 77).encode
    for texts, ids in (("words", "word_tokens"), ("sample_texts", "sample_tokens")):
        for text, wanted in zip(expected[texts], expected[ids], strict=True):
            mine = encode(str(text))
            assert [*mine, *[0] * (77 - len(mine))] == wanted.tolist(), text


def test_text_vectors(encoder: LsegEncoder, expected: Expected) -> None:
    vectors = encoder.text_vectors([str(word) for word in expected["words"]])

    assert np.abs(vectors - expected["text_features"].astype(np.float32)).max() <= 1e-5


@pytest.mark.parametrize("case", CASES)
def test_embeddings(case: str, runs: "functools._lru_cache_wrapper[Run]", expected: Expected) -> None:
    run, wanted = runs(case), expected[f"{case}_embeddings"].astype(np.float32)
    mine = run.embeddings

    assert run.grid == tuple(expected[f"{case}_grid"])
    cosines = (mine * wanted).sum(1) / np.linalg.norm(mine, axis=1) / np.linalg.norm(wanted, axis=1)
    off = np.abs(mine - wanted)
    print(f"{case}: cosine {cosines.min():.7f}, largest {off.max():.1e}, mean {off.mean():.1e}")
    assert cosines.min() >= 0.99999
    assert off.max() <= 5e-3
    assert off.mean() <= 2e-5


@pytest.mark.parametrize("case", CASES)
def test_labels(case: str, runs: "functools._lru_cache_wrapper[Run]", expected: Expected) -> None:
    alike = runs(case).labels == expected[f"{case}_labels"]
    clear = expected[f"{case}_margin_milli"].astype(int) >= 5

    print(f"{case}: {alike.mean():.6f} of labels equal, {(~alike & clear).sum()} of {clear.sum()} clear ones not")
    assert alike[clear].all()
    assert alike.mean() >= 0.999


@pytest.mark.parametrize("case", CASES)
def test_traces(case: str, runs: "functools._lru_cache_wrapper[Run]", expected: Expected) -> None:
    trace = runs(case).trace
    compared = 0
    for index, name in enumerate(expected["trace_names"]):
        values = expected[f"{case}_trace_values"][index].astype(np.float32)
        mean, deviation = expected[f"{case}_trace_stats"][index].astype(float)
        if trace.sizes[name][1:] in {(120, 120), (240, 240)} or name not in {"layer1_rn", "refinenet1", "head1"}:
            assert np.abs(trace.values[name].numpy() - values).max() <= 1e-3 * deviation, name
            assert abs(trace.statistics[name][0] - mean) <= 1e-3 * deviation, name
            assert trace.statistics[name][1] == pytest.approx(deviation, rel=1e-3), name
            compared += 1
    # Only the tall picture fills its first window; of the others the last layers are computed as far as they are used.
    assert compared == (14 if case == "tall" else 11)
