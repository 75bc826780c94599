"""The decoder that hands each image to one of a few processes."""

import hashlib
import logging
import queue
import threading
import time
from collections.abc import Callable
from datetime import datetime
from typing import TypeVar

import numpy as np

from schemas.errors import BadImage, BodyTooLarge, Busy, RevisitError, Unavailable
from schemas.image import Image
from schemas.settings import Settings
from schemas.threads import Threads
from worker.images.apart.buffers import Buffers
from worker.images.apart.process import DecoderProcess, Died, Hung
from worker.images.apart.protocol import DECODE, READ_EXIF, THUMBNAIL
from worker.images.codec import Limits, check_length, is_too_large
from worker.images.decoder import Decoder, InProcessDecoder
from worker.images.exif import Known

log = logging.getLogger(__name__)

Made = TypeVar("Made")

LARGEST_KEPT = 64 * 1024 * 1024
"""Bytes of the largest image whose memory is kept for the next."""

RETRY_S = 1.0
"""Seconds between attempts to start a process for an image that can wait."""


class DecoderPool:
    """Decodes in processes of their own; keeps the promises of `Decoder`.

    An image whose process dies is tried once more in a fresh one, since the process may have been killed for another
    reason. An image that ends both, or takes longer than the deadline, is refused. Other images go on meanwhile in
    the other processes.

    Parameters
    ----------
    count : int
        Processes, and so images decoded at once.
    limits : Limits
    deadline_s : float
        Seconds for one image, and for one to wait for its turn.
    """

    def __init__(self, count: int, limits: Limits, deadline_s: float) -> None:
        self._limits, self._deadline_s = limits, deadline_s
        self._launching = Threads(1, "revisit-decoders")
        self.processes = [DecoderProcess(limits, deadline_s, self._launching) for _ in range(count)]
        # The latest one used first: its memory is warm, and one that is never needed is never touched.
        self._free: queue.LifoQueue[DecoderProcess] = queue.LifoQueue()
        for process in reversed(self.processes):
            self._free.put(process)
        self._closed = threading.Event()
        self._buffers = Buffers(count + 1, LARGEST_KEPT)
        self._one_larger = threading.Lock()

    @property
    def restarts(self) -> int:
        """Times that a process was started anew after its predecessor ended."""
        return sum(max(0, process.starts - 1) for process in self.processes)

    def start(self) -> None:
        """Start all processes, without waiting for them."""
        for process in self.processes:
            process.start()

    def check(self) -> str:
        """``ok``, or why no process can be started; one that has ended is started for it, and waited for."""
        try:
            process = self._free.get_nowait()
        except queue.Empty:
            return "ok"  # all are at work
        try:
            if not process.runs:
                process.make_ready()
        except Unavailable as error:
            return error.detail
        finally:
            self._free.put(process)
        return "ok"

    def decode(self, data: bytes, *, patient: bool = False, stored: bool = False) -> Image:
        """An image; raises BadImage, BodyTooLarge, Busy, Unavailable."""
        while True:
            try:
                return self._decode(data, patient=patient, stored=stored)
            except Unavailable:
                if not patient or self._closed.wait(RETRY_S):
                    raise

    def thumbnail(self, data: bytes, longest: int) -> bytes:
        """A small JPEG; raises BadImage, Busy, Unavailable."""

        def made(process: DecoderProcess) -> bytes:
            return self._thumbnail(process, data, longest)

        if len(data) > self._limits.max_bytes:
            return self._with_larger(data, made)
        return self._with_process(made, patient=False)

    def read_exif(self, data: bytes) -> Known:
        """What the EXIF says; waits for its turn, and raises BadImage where reading it ends the process."""
        check_length(data, self._limits)
        return self._with_process(lambda process: self._read_exif(process, data), patient=True)

    def close(self) -> None:
        """End all processes, after the images that they decode."""
        self._closed.set()
        for _ in self.processes:
            try:
                self._free.get(timeout=self._deadline_s + 1).kill()
            except queue.Empty:
                log.warning("a decoder did not come back; its own alarm ends it")

    def _decode(self, data: bytes, *, patient: bool, stored: bool) -> Image:
        try:
            check_length(data, self._limits)
            return self._with_process(lambda process: self._image(process, data), patient=patient)
        except (BadImage, BodyTooLarge) as error:
            if not stored or not is_too_large(error):
                raise
        return self._with_larger(data, lambda process: self._image(process, data))

    def _image(self, process: DecoderProcess, data: bytes) -> Image:
        reply, memory = process.ask(DECODE, data)
        _raise_refusal(reply)
        height, width = int(reply["height"]), int(reply["width"])
        size = 3 * height * width
        if not 0 < size <= len(memory):
            raise Died("its reply makes no sense")
        view = np.frombuffer(memory, np.uint8, size)
        pixels = self._buffers.copy(view.reshape(height, width, 3))
        del view  # a mapping with views cannot be closed
        process.tidy(size)
        return Image(pixels, hashlib.sha256(data).hexdigest(), str(reply["format"]), len(data))

    def _thumbnail(self, process: DecoderProcess, data: bytes, longest: int) -> bytes:
        reply, memory = process.ask(THUMBNAIL, data, longest)
        _raise_refusal(reply)
        return memory[: int(reply["length"])]

    def _read_exif(self, process: DecoderProcess, data: bytes) -> Known:
        reply, _ = process.ask(READ_EXIF, data)
        _raise_refusal(reply)
        known, moment = dict(reply["known"]), reply["captured_at"]
        return known if moment is None else {**known, "captured_at": datetime.fromisoformat(moment)}

    def _with_process(self, use: Callable[[DecoderProcess], Made], *, patient: bool) -> Made:
        process = self._borrow(patient)
        try:
            return self._used(process, use)
        finally:
            self._free.put(process)

    def _with_larger(self, data: bytes, use: Callable[[DecoderProcess], Made]) -> Made:
        """With a process for an image that was accepted by larger limits than those of now; one at a time."""
        with self._one_larger:
            process = DecoderProcess(Limits.that_allow(data), self._deadline_s, self._launching)
            try:
                return self._used(process, use)
            finally:
                process.kill()

    def _used(self, process: DecoderProcess, use: Callable[[DecoderProcess], Made]) -> Made:
        """What is made with a process; an image that ends it twice, or hangs, is refused."""
        try:
            try:
                return use(process)
            except Died as error:
                log.warning("a decoder died: %s; the image is tried once more", error)
                process.kill()
                return use(process)
        except Died as error:
            process.kill()
            log.warning("an image ended its decoder twice: %s", error)
            raise BadImage("undecodable-picture", f"this image cannot be decoded: {error}, twice") from error
        except Hung as error:
            log.warning("an image took its decoder longer than %g s", self._deadline_s)
            raise BadImage(
                "undecodable-picture", f"this image cannot be decoded within {self._deadline_s:g} s"
            ) from error

    def _borrow(self, patient: bool) -> DecoderProcess:
        began = time.monotonic()
        while not self._closed.is_set():
            try:
                return self._free.get(timeout=min(1.0, self._deadline_s))
            except queue.Empty:
                if not patient and time.monotonic() - began > self._deadline_s:
                    wait = max(1, round(self._deadline_s))
                    raise Busy(f"all decoders are at work; try again in {wait} s", wait) from None
        raise Unavailable("the service is stopping; try again in 5 s", 5)


def _raise_refusal(reply: dict[str, object]) -> None:
    if "error" in reply:
        if reply["error"] == "BodyTooLarge":
            raise BodyTooLarge(str(reply["detail"]))
        refusal: RevisitError = BadImage(str(reply["code"]), str(reply["detail"]))
        raise refusal


def make_decoder(settings: Settings) -> Decoder:
    """Decoders in processes of their own, or in this one where the settings ask for none."""
    limits = Limits.of(settings)
    return DecoderPool(settings.decoders, limits, settings.decode_s) if settings.decoders else InProcessDecoder(limits)
