"""What two servers could read in two ways is refused, the rest is read as RFC 9112 says; never a 500, never silence."""

from collections.abc import Iterator

import pytest

from tests.stories.raw import answers, connect, read_all, say
from tests.stories.running import RunningService

pytestmark = pytest.mark.one_database("such requests never reach the database")

END = b"Connection: close\r\n\r\n"

REFUSED = {
    "Content-Length and Transfer-Encoding": b"GET /livez HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\n"
    b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "two Content-Lengths": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nabcdef",
    "a list of Content-Lengths": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: 5, 6\r\n\r\nabcdef",
    "a negative Content-Length": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: -1\r\n\r\n",
    "a signed Content-Length": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: +1\r\n\r\na",
    "a Content-Length of 30 digits": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: " + b"9" * 30 + b"\r\n\r\na",
    "an unknown Transfer-Encoding": b"POST /query HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: gzip, chunked\r\n\r\n",
    "two Transfer-Encodings": b"POST /query HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n"
    b"Transfer-Encoding: identity\r\n\r\n0\r\n\r\n",
    "Transfer-Encoding in HTTP/1.0": b"POST /query HTTP/1.0\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "a blank before the colon": b"GET /livez HTTP/1.1\r\nHost: a\r\nContent-Length : 5\r\n\r\n",
    "a header without a name": b"GET /livez HTTP/1.1\r\nHost: a\r\n: b\r\n\r\n",
    "a header without a colon": b"GET /livez HTTP/1.1\r\nHost: a\r\nodd\r\n\r\n",
    "a fold before any header": b"GET /livez HTTP/1.1\r\n Host: a\r\n\r\n",
    "NUL in a header": b"GET /livez HTTP/1.1\r\nHost: a\r\nX-A: b\0c\r\n\r\n",
    "CR in a header": b"GET /livez HTTP/1.1\r\nHost: a\r\nX-A: b\rX-B: c\r\n\r\n",
    "NUL in the path": b"GET /views/a\0b HTTP/1.1\r\nHost: a\r\n\r\n",
    "an encoded NUL in the path": b"GET /views/a%00b HTTP/1.1\r\nHost: a\r\n\r\n",
    "an encoded byte that is no UTF-8 in the path": b"GET /maps/caf%e9 HTTP/1.1\r\nHost: a\r\n\r\n",
    "an encoded line end in the path": b"GET /views/a%0d%0ab HTTP/1.1\r\nHost: a\r\n\r\n",
    "bytes beyond ASCII in the path": b"GET /views/\xff HTTP/1.1\r\nHost: a\r\n\r\n",
    "no Host in HTTP/1.1": b"GET /livez HTTP/1.1\r\n\r\n",
    "two Hosts": b"GET /livez HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    "HTTP/2 with prior knowledge": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "HTTP/0.9": b"GET /livez\r\n\r\n",
    "HTTP/3.7": b"GET /livez HTTP/3.7\r\n\r\n",
    "a TLS handshake": bytes.fromhex("16030100a5010000a1030346") + bytes(150),
    "a target that is no path": b"GET livez HTTP/1.1\r\nHost: a\r\n\r\n",
    "the target of a CONNECT": b"CONNECT example.org:443 HTTP/1.1\r\nHost: a\r\n\r\n",
    "three blanks": b"GET  /livez  HTTP/1.1\r\nHost: a\r\n\r\n",
    "a chunk size that is no number": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\n"
    b"Transfer-Encoding: chunked\r\n\r\nxyz\r\n\r\n",
    "a chunk longer than its size": b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\n"
    b"Transfer-Encoding: chunked\r\n\r\n1\r\nabc\r\n0\r\n\r\n",
}

READ = {
    "HTTP/1.0 without Host": b"GET /livez HTTP/1.0\r\n\r\n",
    "line ends without CR": b"GET /livez HTTP/1.1\nHost: a\nConnection: close\n\n",
    "a folded header (a blank instead)": b"GET /livez HTTP/1.1\r\nHost: a\r\nX-A: b\r\n c\r\n" + END,
    "the absolute form": b"GET http://example.org/livez HTTP/1.1\r\nHost: a\r\n" + END,
    "the same Content-Length twice": b"GET /livez HTTP/1.1\r\nHost: a\r\nContent-Length: 0\r\nContent-Length: 0\r\n"
    + END,
    "an empty chunked body": b"GET /livez HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n" + END + b"0\r\n\r\n",
    "another protocol that is offered": b"GET /livez HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\n"
    b"Connection: upgrade, close\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
    "an offer of HTTP/2": b"GET /livez HTTP/1.1\r\nHost: a\r\nUpgrade: h2c\r\nConnection: upgrade, close\r\n\r\n",
}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with RunningService(tmp_path_factory.mktemp("malformed"), REVISIT_HEAD_S="2", REVISIT_BODY_S="2") as service:
        yield service


@pytest.mark.parametrize("shape", REFUSED)
def test_what_is_malformed_is_a_bad_request(service: RunningService, shape: str) -> None:
    (answer,) = say(service, REFUSED[shape])
    assert (answer.status, answer.problem(), answer.headers["connection"]) == (400, "bad-request", "close")


@pytest.mark.parametrize("shape", READ)
def test_what_is_unusual_is_read(service: RunningService, shape: str) -> None:
    (answer,) = say(service, READ[shape])
    assert (answer.status, answer.body) == (200, b"ok\n")


def test_requests_in_a_row_are_answered_in_their_order(service: RunningService) -> None:
    one = b"GET %s HTTP/1.1\r\nHost: a\r\n\r\n"
    paths = [b"/livez", b"/maps", b"/views/none", b"/livez?odd=1", b"/version"]
    found = say(service, b"".join(one % path for path in paths) + b"GET /livez HTTP/1.1\r\nHost: a\r\n" + END)
    assert [answer.status for answer in found] == [200, 200, 404, 422, 200, 200]


def test_head_is_answered_without_a_body_and_the_connection_goes_on(service: RunningService) -> None:
    paths = (b"/maps", b"/docs", b"/views/none", b"/openapi.json")
    heads = b"".join(b"HEAD %s HTTP/1.1\r\nHost: a\r\n\r\n" % path for path in paths)
    with connect(service) as connection:
        connection.sendall(heads + b"GET /livez HTTP/1.1\r\nHost: a\r\n" + END)
        raw = read_all(connection)
    *starts, last = [part.split(b"\r\n")[0] for part in raw.split(b"\r\n\r\n")]
    assert [start.split()[1] for start in starts] == [b"200", b"200", b"404", b"200", b"200"]
    assert last == b"ok\n"


def test_nothing_is_read_as_a_request_behind_a_refused_body(service: RunningService) -> None:
    """The body looks like a request; behind the refusal it is thrown away."""
    inner = b"DELETE /maps/campus HTTP/1.1\r\nHost: a\r\n\r\n"
    (answer,) = say(service, b"GET /livez HTTP/1.1\r\nHost: a\r\nContent-Length: %d\r\n\r\n" % len(inner) + inner)
    assert (answer.status, answer.problem(), answer.headers["connection"]) == (400, "unexpected-body", "close")
    smuggled = REFUSED["Content-Length and Transfer-Encoding"] + inner
    assert [answer.status for answer in say(service, smuggled)] == [400]


def test_a_request_that_breaks_off_leaves_the_service_as_it_was(service: RunningService) -> None:
    for begun in (b"", b"GET /li", b"POST /enroll HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\nabc"):
        with connect(service) as connection:
            connection.sendall(begun)
    with connect(service) as connection:
        connection.sendall(READ["HTTP/1.0 without Host"])
        (answer,) = answers(read_all(connection))
    assert answer.status == 200


def test_an_unknown_method_is_refused_by_its_name(service: RunningService) -> None:
    for method in (b"BREW", b"TRACE", b"OPTIONS", b"get", b"x" * 100):
        (answer,) = say(service, method + b" /maps HTTP/1.1\r\nHost: a\r\n" + END)
        assert (answer.status, answer.problem()) == (405, "method-not-allowed")


def test_no_answer_can_be_read_as_something_else(service: RunningService) -> None:
    ok, missing = say(service, b"GET /maps HTTP/1.1\r\nHost: a\r\n\r\nGET /views/none HTTP/1.1\r\nHost: a\r\n" + END)
    for answer in (ok, missing):
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["content-security-policy"] == "default-src 'none'; frame-ancestors 'none'; sandbox"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
    assert missing.headers["cache-control"] == "no-store"
