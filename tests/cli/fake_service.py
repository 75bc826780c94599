"""A service over real HTTP that answers what it is told to, and remembers what it was sent."""

import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Reply = tuple[int, Any]
"""Status, and what is sent: bytes as they are, anything else as JSON."""


@dataclass
class FakeService:
    """Replies by method and path (without the query); a function is given the request's body."""

    url: str
    replies: dict[str, Reply | Callable[[bytes], Reply]] = field(default_factory=dict)
    requests: list[tuple[str, bytes]] = field(default_factory=list)
    keys: list[str | None] = field(default_factory=list)


class _Server(ThreadingHTTPServer):
    """Says nothing of callers that went away: its threads would say it on the stderr of a later test."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


@contextmanager
def fake_service() -> Iterator[FakeService]:
    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            if self.headers.get("transfer-encoding") == "chunked":
                body = b""
                while size := int(self.rfile.readline(), 16):
                    body += self.rfile.read(size)
                    self.rfile.readline()
                self.rfile.readline()
            else:
                body = self.rfile.read(int(self.headers.get("content-length") or 0))
            service.keys.append(self.headers.get("authorization"))
            service.requests.append((f"{self.command} {self.path}", body))
            reply = service.replies.get(f"{self.command} {self.path.partition('?')[0]}")
            status, content = reply(body) if callable(reply) else reply or (404, {})
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            self.send_response(status)
            self.send_header("content-length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        do_GET = do_POST = do_PUT = do_DELETE = do_PATCH = answer  # noqa: N815 (names that http.server looks for)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = _Server(("127.0.0.1", 0), Handler)
    service = FakeService(f"http://127.0.0.1:{server.server_port}")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield service
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
