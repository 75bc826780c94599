import importlib

import numpy as np
import pytest
import torch

from training.export_onnx import onnx_bytes
from worker.encoders.compact_network import CompactNetwork


@pytest.mark.parametrize(("height", "width"), [(96, 128), (32, 64), (288, 480)])
def test_the_onnx_file_answers_like_the_network_at_any_multiple_of_32(height: int, width: int) -> None:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    onnxruntime = importlib.import_module("onnxruntime")
    torch.manual_seed(0)
    halves = {name: tensor.half() for name, tensor in CompactNetwork().state_dict().items()}
    network = CompactNetwork.loaded(halves)
    session = onnxruntime.InferenceSession(onnx_bytes(network), providers=["CPUExecutionProvider"])
    pictures = torch.rand(2, 3, height, width)

    with torch.inference_mode():
        expected = network(pictures)
    answered = session.run(["words", "detail"], {"pictures": pictures.numpy()})

    for one, other in zip(expected, answered, strict=True):
        assert one.shape == other.shape
        assert np.abs(one.numpy() - other).max() < 1e-4
