"""A deadline breaks a connection while another thread speaks over it."""

import socket
import ssl
import threading
from pathlib import Path

from app.http.deadline import Deadline
from tests.certificates import self_signed
from tests.waiting import until


def test_a_read_over_tls_that_has_begun_ends_as_one_of_a_broken_connection(tmp_path: Path) -> None:
    """Of a connection without TLS, which is not what it was called for, a read would be an error of another kind."""
    key, certificate = self_signed(tmp_path)
    serving = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    serving.load_cert_chain(certificate, key)
    calling = ssl.create_default_context(cafile=certificate)
    ours, theirs = socket.socketpair()
    other = threading.Thread(target=lambda: serving.wrap_socket(theirs, server_side=True).close())
    deadline = Deadline()
    with calling.wrap_socket(ours, server_hostname="localhost", do_handshake_on_connect=False) as connection:
        other.start()
        connection.do_handshake()
        other.join()
        deadline.trace("connection.start_tls.complete", {"return_value": Stream(connection)})
        with deadline.within(0):
            until(lambda: deadline.is_over)
            assert connection.read(1) == b""  # what `recv` calls once it has seen that there is TLS


class Stream:
    """What httpx tells of a connection."""

    def __init__(self, connection: ssl.SSLSocket) -> None:
        self._connection = connection

    def get_extra_info(self, info: str) -> ssl.SSLSocket:
        """Its socket."""
        assert info == "socket"
        return self._connection
