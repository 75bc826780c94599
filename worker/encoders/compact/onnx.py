"""The compact network in ONNX Runtime, for CPUs, and sessions of other graphs that ship."""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from schemas.description import Floats
from schemas.errors import SetupError
from schemas.image import Bytes2D

_ONLY_ERRORS = 3


class OnnxEngine:
    """Runs the exported graphs. No result depends on the number of threads or on other images in a batch.

    There are several graphs because ONNX Runtime computes every output of a graph, also unused ones.

    Parameters
    ----------
    fields : Path or None
        Graph with the outputs ``words`` (the layer semantic) and ``detail``; its weights lie in the safetensors file
        beside it. None for an engine that only segments.
    fine : sequence of Path
        Graphs with the output ``fine_words``, one for each ensemble member, with weights beside them likewise.
    threads : int
        Threads for one image.

    Raises
    ------
    SetupError
        ONNX Runtime cannot be imported, or cannot load a graph.
    """

    def __init__(self, fields: Path | None, fine: Sequence[Path] = (), *, threads: int) -> None:
        self._fields = None if fields is None else open_session(fields, threads)
        self._fine = [open_session(graph, threads) for graph in fine]

    def fields(self, images: Bytes2D) -> tuple[Floats, Floats]:
        """See `Engine.fields`."""
        if self._fields is None:
            raise SetupError("this engine only segments: its fields come from a shared encoder")
        words, detail = self._fields.run(["words", "detail"], {"pictures": images})
        return words, detail

    def segment(self, images: Bytes2D, member: int) -> Floats:
        """See `Engine.segment`."""
        words: Floats = self._fine[member].run(["fine_words"], {"pictures": images})[0]
        return words


def open_session(graph: Path, threads: int) -> Any:
    """Load a graph.

    Raises
    ------
    SetupError
        ONNX Runtime cannot be imported, or cannot load it.
    """
    try:
        runtime: Any = importlib.import_module("onnxruntime")
    except ImportError as error:
        raise SetupError(
            f"{graph.name} runs in ONNX Runtime, which cannot be imported ({error}); "
            "install the package onnxruntime as requirements.lock has it"
        ) from error
    options = runtime.SessionOptions()
    options.log_severity_level = _ONLY_ERRORS
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Threads that spin while they wait for work take CPU time from the rest of the service.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Memory patterns are kept for every input size: no measurable gain, and memory grows with the number of sizes.
    options.enable_mem_pattern = False
    try:
        return runtime.InferenceSession(str(graph), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's errors have no common base class
        reason = str(error).strip().splitlines()[0]
        raise SetupError(f"ONNX Runtime {runtime.__version__} cannot load {graph.name}: {reason}") from error
