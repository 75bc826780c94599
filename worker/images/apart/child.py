"""The process that decodes: ``python -m worker.images.apart.child SOCKET INPUT OUTPUT MAX_BYTES MAX_PIXELS SECONDS``.

It holds three descriptors: a socket, and memory for the bytes that came and for what became of them. It ends when the
other end of the socket is closed, which the kernel does when the service dies, and while it decodes an alarm ends it
that no codec can hold up.
"""

import io
import math
import signal
import socket
import sys
from contextlib import suppress
from typing import Any

import cv2
import numpy as np
from PIL import Image as PilImage

from schemas.errors import RevisitError
from worker.images import codec
from worker.images.apart.protocol import READ_EXIF, READY, THUMBNAIL, Request, mapped, send_reply
from worker.images.apart.restraints import restrict
from worker.images.exif import read_exif
from worker.images.heic import SMALLEST

_FORMATS = ("BMP", "JPEG", "PNG", "TIFF", "WEBP")


def main(arguments: list[str]) -> None:
    """Serve requests until the other end is closed."""
    number, given, made, max_bytes, max_pixels = map(int, arguments[:5])
    seconds = float(arguments[5])
    # A terminal sends Ctrl-C, a supervisor SIGTERM, to all processes: a service that drains still needs its decoders.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    limits = codec.Limits(max_bytes, max_pixels)
    source, target = mapped(given), mapped(made)
    cv2.setNumThreads(1)
    _warm_up()
    restrict(max_pixels)
    with socket.socket(fileno=number) as connection:
        connection.sendall(READY)
        while True:
            try:
                request = Request.receive(connection)
            except (EOFError, OSError):
                return
            signal.alarm(math.ceil(seconds) + 1)
            reply = _answer(request, source[: request.length], target, limits)
            signal.alarm(0)
            with suppress(BrokenPipeError):  # the service is gone: the next request will not come
                send_reply(connection, reply)


def _answer(request: Request, data: bytes, target: Any, limits: codec.Limits) -> dict[str, Any]:
    """Decode into the target; a reply with the shape, a length, or the error's type, code and detail."""
    try:
        if request.kind == THUMBNAIL:
            small = codec.thumbnail(data, request.longest)
            target[: len(small)] = small
            return {"length": len(small)}
        if request.kind == READ_EXIF:
            known = read_exif(io.BytesIO(data))
            moment = known.pop("captured_at", None)
            return {"known": known, "captured_at": None if moment is None else moment.isoformat()}
        room = np.frombuffer(target, np.uint8)
        pixels, form = codec.decode_pixels(data, limits, room)
        if not np.may_share_memory(pixels, room):
            room[: pixels.size].reshape(pixels.shape)[:] = pixels
        return {"height": pixels.shape[0], "width": pixels.shape[1], "format": form}
    except RevisitError as error:
        return {"error": type(error).__name__, "code": error.code, "detail": error.detail}
    except MemoryError:
        return {"error": "BadImage", "code": "undecodable-picture", "detail": "decoding it needs too much memory"}
    except Exception as error:
        detail = f"decoding it failed ({type(error).__name__}: {error})"
        return {"error": "BadImage", "code": "undecodable-picture", "detail": detail}


def _warm_up() -> None:
    """Import everything that decoding imports late, before opening files is forbidden."""
    limits, pixels = codec.Limits(), np.zeros((32, 32, 3), np.uint8)
    for form in _FORMATS:
        for mode in ("RGB", "L"):
            out = io.BytesIO()
            PilImage.fromarray(pixels).convert(mode).save(out, form)
            codec.decode(out.getvalue(), limits)
            codec.thumbnail(out.getvalue(), 16)
    codec.decode(SMALLEST, limits)
    read_exif(io.BytesIO(SMALLEST))


if __name__ == "__main__":
    main(sys.argv[1:])
