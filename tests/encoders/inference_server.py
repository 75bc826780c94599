"""A server of models for tests: it answers right, or as badly as a test wants."""

import time
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from schemas.image import Image, PreparedImage
from schemas.inference import JSON_LENGTH, Tensor, packed, unpacked
from worker.encoders.compact.encoder import CompactEncoder

SHORT_S = 0.5
"""For servers that do not answer."""

Answer = Callable[["Handler", dict[str, Tensor]], None]


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        server = self.server
        assert isinstance(server, InferenceServer)
        said, tensors = unpacked("inputs", self.headers[JSON_LENGTH], body)
        shape = tensors["pictures" if "pictures" in tensors else "pictures.0"].shape
        server.received.append((self.path, said, self.headers["authorization"], shape))
        server.answer(self, tensors)

    def do_GET(self) -> None:
        server = self.server
        assert isinstance(server, InferenceServer)
        self.give(404 if server.segmenter is None else 200, b"{}")

    def give(self, status: int, body: bytes, **headers: str) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


class InferenceServer(ThreadingHTTPServer):
    """Answers by the rule of the moment, and remembers what it received."""

    daemon_threads = True

    def __init__(self, segments: bool = False) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.encoder = CompactEncoder(prepared=True, segments=segments)
        self.segmenter = self.encoder.segmenter()
        self.received: list[tuple[str, dict[str, object], str | None, tuple[int, ...]]] = []
        self.answer: Answer = self.right
        self.url = f"http://127.0.0.1:{self.server_address[1]}"

    def right(self, handler: Handler, tensors: dict[str, Tensor]) -> None:
        path, said, _, _ = self.received[-1]
        if "-segmenter-" in path:
            self.segmented(handler, tensors, said["parameters"])
            return
        fields = list(self.encoder.encode([Image(np.asarray(one, np.uint8), "0" * 64) for one in tensors["pictures"]]))
        layers = {
            name: np.stack([f.layers[layer] for f in fields])
            for layer, name in (("semantic", "words"), ("detail", "detail"))
        }
        length, body = packed("outputs", layers, {})
        handler.give(200, body, **{JSON_LENGTH.replace("-", "_"): str(length)})

    def segmented(self, handler: Handler, tensors: dict[str, Tensor], parameters: Any) -> None:
        if self.segmenter is None:
            handler.give(404, b'{"error": "unknown model"}')
            return
        scales = tuple(np.asarray(tensors[name][0], np.uint8) for name in sorted(tensors))
        image = PreparedImage(scales[-1], "0" * 64, scales=scales, grid=(parameters["rows"], parameters["columns"]))
        length, body = packed("outputs", {"segmentation": self.segmenter.segment(image).semantic[None]}, {})
        handler.give(200, body, **{JSON_LENGTH.replace("-", "_"): str(length)})


def says(status: int, text: str = '{"error": "so it says"}', **headers: str) -> Answer:
    return lambda handler, _: handler.give(status, text.encode(), **headers)


def hangs(handler: Handler, _: dict[str, Tensor]) -> None:
    time.sleep(4 * SHORT_S)
    handler.close_connection = True


def trickles(handler: Handler, _: dict[str, Tensor]) -> None:
    handler.send_response(200)
    handler.send_header("content-length", "100000")
    handler.end_headers()
    with suppress(OSError):
        for _byte in range(200):
            handler.wfile.write(b"x")
            time.sleep(SHORT_S / 5)


def floods(handler: Handler, _: dict[str, Tensor]) -> None:
    handler.send_response(200)
    handler.end_headers()
    with suppress(OSError):
        while True:
            handler.wfile.write(bytes(1_000_000))


def breaks_off(handler: Handler, _: dict[str, Tensor]) -> None:
    handler.close_connection = True
