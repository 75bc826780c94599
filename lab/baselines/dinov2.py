"""DINOv2 ViT-S/14 (Oquab et al. 2023, "DINOv2: Learning Robust Visual Features without Supervision").

Its weights are not in this repository (Apache-2.0). They are read from an ONNX file of the original network with a
fixed input of 224 x 224, such as packages of the Python index carry; `docs/research/evaluation.md` names one.
"""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lab.libraries import for_studies
from schemas.errors import SetupError

SIZE = 224
"""Height and width of the input, in pixels."""

SIDE = SIZE // 14
"""Tokens along either side."""

CHANNELS = 384

BLOCK = 9
"""Tokens after this block (of 0..11) are the ones distilled: later ones say what a thing is, but less where it is."""

WHERE = "docs/research/evaluation.md says where they can be had"
"""Of weights that are missing; ends every error about them."""

_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)


class DinoV2:
    """Patch tokens of one block.

    Parameters
    ----------
    path : Path
        The ONNX file.
    threads : int
    block : int

    Raises
    ------
    SetupError
        There is no such file, it is not this network, or the package ``onnx`` is not installed.
    """

    def __init__(self, path: Path, threads: int = 1, block: int = BLOCK) -> None:
        with for_studies():
            onnx: Any = importlib.import_module("onnx")
            runtime: Any = importlib.import_module("onnxruntime")
        if not path.is_file():
            raise SetupError(f"{path}: there is no such file; DINOv2's weights are not shipped, {WHERE}")
        try:
            model = onnx.load(str(path))
        except Exception as error:  # the parser's own errors, which belong to another package
            raise SetupError(f"{path} cannot be read as an ONNX file: {str(error).splitlines()[0]}; {WHERE}") from None
        wanted = f"/blocks.{block}/Add_1_output_0"
        if wanted not in {name for node in model.graph.node for name in node.output}:
            raise SetupError(f"{path} has no output {wanted} within; is it DINOv2 ViT-S/14? {WHERE}")
        del model.graph.output[:]
        model.graph.output.append(onnx.helper.make_tensor_value_info(wanted, onnx.TensorProto.FLOAT, None))
        options = runtime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        self._session = runtime.InferenceSession(model.SerializeToString(), options)

    def tokens(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.float16]:
        """Tokens of an RGB image, uint8 (224, 224, 3), row by row: float16 (16, 16, 384)."""
        x = (image.astype(np.float32) / 255 - _MEAN) / _DEVIATION
        (found,) = self._session.run(None, {"input": x.transpose(2, 0, 1)[None]})
        return np.asarray(found[0, 1:].reshape(SIDE, SIDE, CHANNELS), np.float16)
