"""An S3-compatible store to try images in: moto's server, over HTTP, and one that refuses everything."""

import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import boto3
from moto.server import ThreadedMotoServer

from worker.storage.owner_file import OWNER
from worker.storage.signs import ALIVE

BUCKET = "places"
ADDRESS = f"s3://{BUCKET}/museum/images"
PREFIX = "museum/images/"


class ObjectStore:
    """A server with one bucket, empty at first; what it holds outlives `stop`."""

    def __init__(self) -> None:
        logging.getLogger("werkzeug").setLevel(logging.ERROR)
        self._port = 0
        self.start()
        self.client = boto3.client("s3", **self.credentials)
        self.client.create_bucket(Bucket=BUCKET)
        self.empty()  # servers of one process share what they hold

    def start(self) -> None:
        """Start it, again after `stop`."""
        self._server = ThreadedMotoServer(ip_address="127.0.0.1", port=self._port, verbose=False)
        self._server.start()
        self._port = self._server.get_host_and_port()[1]

    def stop(self) -> None:
        """Stop it."""
        self._server.stop()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    @property
    def credentials(self) -> dict[str, str]:
        return {
            "endpoint_url": self.url,
            "region_name": "us-east-1",
            "aws_access_key_id": "museum",
            "aws_secret_access_key": "not-secret",
        }

    @property
    def environment(self) -> dict[str, str]:
        """Variables for a service that uses it."""
        return {"REVISIT_IMAGES": ADDRESS, **aws(self.url)}

    def names(self) -> list[str]:
        """Names of all objects below the prefix, but for those that say of which database they are."""
        found = self.client.list_objects_v2(Bucket=BUCKET, Prefix=PREFIX).get("Contents", [])
        return sorted({str(each["Key"]).removeprefix(PREFIX) for each in found} - {OWNER, ALIVE})

    def take(self, folder: Path) -> None:
        """Copy all files of a folder into the store, as `aws s3 sync` does."""
        for path in folder.rglob("*"):
            if path.is_file():
                name = PREFIX + str(path.relative_to(folder))
                self.client.put_object(Bucket=BUCKET, Key=name, Body=path.read_bytes())

    def give(self, folder: Path) -> None:
        """Copy all objects below the prefix into a folder."""
        for each in self.client.list_objects_v2(Bucket=BUCKET, Prefix=PREFIX)["Contents"]:
            path = folder / str(each["Key"]).removeprefix(PREFIX)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(self.client.get_object(Bucket=BUCKET, Key=each["Key"])["Body"].read())

    def unfinished(self) -> list[str]:
        """Names of the objects whose upload has not ended."""
        found = self.client.list_multipart_uploads(Bucket=BUCKET).get("Uploads", [])
        return sorted(str(each["Key"]).removeprefix(PREFIX) for each in found)

    def empty(self) -> None:
        """Remove all objects."""
        for name in (*self.names(), OWNER, ALIVE):
            self.client.delete_object(Bucket=BUCKET, Key=PREFIX + name)


@cache
def server() -> ObjectStore:
    """One for all tests: it ends with the process."""
    return ObjectStore()


def aws(url: str) -> dict[str, str]:
    """The usual variables for a store at an address."""
    return {
        "AWS_ENDPOINT_URL_S3": url,
        "AWS_REGION": "us-east-1",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": "museum",
        "AWS_SECRET_ACCESS_KEY": "not-secret",
        "AWS_EC2_METADATA_DISABLED": "true",
    }


class CuttingProxy:
    """Stands before a store, and cuts connections where it is told to."""

    def __init__(self, url: str) -> None:
        self._to = int(url.rpartition(":")[2])
        self.cuts: list[int] = []  # bytes of answers after which a connection is cut, each once
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listening.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                caller, _ = self._listening.accept()
                server = socket.create_connection(("127.0.0.1", self._to))
                for pair in ((caller, server, False), (server, caller, True)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def _carry(self, source: socket.socket, target: socket.socket, answers: bool) -> None:
        carried = 0
        with source, target, suppress(OSError):
            while piece := source.recv(65536):
                target.sendall(piece)
                carried += len(piece)
                if answers and self.cuts and carried >= self.cuts[0]:
                    self.cuts.pop(0)
                    break
            for end in (source, target):  # closing alone does not wake who reads from it
                end.shutdown(socket.SHUT_RDWR)


@contextmanager
def refusing(status: int, code: str) -> Iterator[str]:
    """The address of a store that answers every call with one error."""
    body = f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>no</Message></Error>".encode()

    class Refusal(BaseHTTPRequestHandler):
        def answer(self) -> None:
            self.rfile.read(int(self.headers.get("content-length") or 0))
            self.send_response(status)
            self.send_header("content-type", "application/xml")
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_PUT = do_DELETE = answer  # noqa: N815

        def log_message(self, format: str, *arguments: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Refusal)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
