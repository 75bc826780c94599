from pathlib import Path

import numpy as np
import onnx
import pytest

from lab.baselines.dinov2 import CHANNELS, SIZE, DinoV2
from schemas.errors import SetupError
from tests.training.tokens import write_teacher


def test_tokens_are_read_row_by_row_from_within_the_graph(tmp_path: Path) -> None:
    image = np.zeros((SIZE, SIZE, 3), np.uint8)
    image[28:42, 70:84] = 255  # the token in row 2, column 5

    tokens = DinoV2(write_teacher(tmp_path / "teacher.onnx")).tokens(image)

    assert tokens.shape == (16, 16, CHANNELS)
    brightest = np.unravel_index(tokens[..., 0].argmax(), (16, 16))
    assert tuple(int(i) for i in brightest) == (2, 5)
    # The drawn teacher's first channel is the mean of what it is given: red is normalised by ImageNet's numbers.
    assert float(tokens[2, 5, 0]) == pytest.approx((1 - 0.485) / 0.229, rel=1e-2)
    assert float(tokens[0, 0, 0]) == pytest.approx((0 - 0.485) / 0.229, rel=1e-2)


def test_another_network_is_refused(tmp_path: Path) -> None:
    path = write_teacher(tmp_path / "teacher.onnx")
    model = onnx.load(str(path))
    model.graph.node[-1].output[0] = "something else"
    model.graph.output[0].name = "something else"
    onnx.save(model, str(path))

    with pytest.raises(SetupError, match="is it DINOv2"):
        DinoV2(path)


def test_a_file_that_is_missing_or_none_is_explained(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"no such file; DINOv2's weights are not shipped.*says where"):
        DinoV2(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("no graph")
    with pytest.raises(SetupError, match=r"text\.onnx cannot be read.*says where"):
        DinoV2(tmp_path / "text.onnx")
