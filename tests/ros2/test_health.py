"""What /diagnostics is told of each trouble: what is wrong, what to do, when the next call is made."""

import httpx
import pytest
from revisit_client import ClientError, Revisit
from revisit_ros.encoding import Unusable
from revisit_ros.health import ERROR, OK, STALE, WARN, Link, Report, Trouble, report, trouble_of


def problem(status: int, code: str = "some-code", **headers: str) -> Exception:
    """What the client raises for an answer."""
    body = {"type": f"urn:revisit:{code}", "title": "No", "status": status, "detail": "because", "request_id": "r"}
    transport = httpx.MockTransport(lambda request: httpx.Response(status, json=body, headers=headers))
    with pytest.raises(ClientError) as caught, Revisit("http://x", transport=transport, patience=0) as revisit:
        revisit.maps()
    return caught.value


def away() -> Exception:
    def refuse(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("Connection refused")

    with pytest.raises(ClientError) as caught:
        Revisit("http://x", transport=httpx.MockTransport(refuse), patience=0).maps()
    return caught.value


@pytest.mark.parametrize(
    ("error", "state", "level", "again", "remedy"),
    [
        (away(), "service away", ERROR, True, "./revisit serve"),
        (problem(401, "unauthorized"), "key refused", ERROR, True, "keys create"),
        (problem(403, "forbidden"), "key refused", ERROR, True, "scope"),
        (problem(403, "other-site"), "refused", ERROR, True, "another name"),
        (problem(404, "not-found"), "map missing", ERROR, False, "enrol into it"),
        (problem(408), "service busy", WARN, True, "network"),
        (problem(409, "conflict"), "service busy", WARN, True, "network"),
        (problem(409, "conflict", **{"idempotent-replayed": "true"}), "image refused", WARN, False, "the same again"),
        (problem(413, "body-too-large"), "image refused", WARN, False, "camera"),
        (problem(415, "not-a-picture"), "image refused", WARN, False, "camera"),
        (problem(422, "invalid-parameter"), "refused", ERROR, False, "parameter of the node"),
        (problem(429, "too-many-requests"), "service busy", WARN, True, "rate"),
        (problem(500, "internal"), "service away", ERROR, True, "log"),
        (problem(502), "service away", ERROR, True, "log"),
        (problem(503, "unavailable"), "service busy", WARN, True, "goes on"),
        (problem(507, "disk-full"), "service busy", ERROR, True, "room"),
        (ClientError("http://x answered something that is not revisit's"), "service away", ERROR, True, "url"),
        (Unusable("images come as 'mono16': ..."), "image refused", WARN, False, "message"),
        (ZeroDivisionError("oh"), "refused", ERROR, False, "report"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_each_trouble_has_a_level_and_a_remedy(
    error: Exception, state: str, level: int, again: bool, remedy: str
) -> None:
    trouble = trouble_of(error)
    assert (trouble.state, trouble.level, trouble.again) == (state, level, again)
    assert remedy in trouble.remedy
    assert trouble.detail
    assert "\n" not in trouble.detail


def test_the_next_call_waits_longer_each_time_up_to_half_a_minute() -> None:
    link, pauses = Link(), []
    for _ in range(8):
        link.failed(trouble_of(away()), 100.0)
        pauses.append(next(second for second in range(200) if link.allows(100.0 + second)))
    assert pauses == [1, 2, 4, 8, 16, 30, 30, 30]
    link.succeeded()
    assert link.allows(0.0)
    assert (link.trouble, link.failures) == (None, 0)


def test_the_next_call_waits_as_long_as_the_service_says() -> None:
    link = Link()
    link.failed(trouble_of(problem(429, "too-many-requests", **{"retry-after": "7"})), 0.0)
    assert (link.allows(6.9), link.allows(7.0)) == (False, True)


def test_an_image_that_is_refused_holds_up_no_other() -> None:
    link = Link()
    link.failed(trouble_of(Unusable("no")), 5.0)
    assert link.allows(5.0)


def told(link: Link, *, now: float = 10.0, last_image: float | None = 9.9, note: str = "") -> Report:
    return report(
        link,
        now,
        last_image=last_image,
        started=0.0,
        silence_s=5.0,
        topic="/image",
        doing="all is well",
        note=note,
        values={"n": "1"},
    )


def test_what_is_worst_is_told() -> None:
    well, broken, unwell = Link(), Link(), Link()
    broken.failed(Trouble("service away", ERROR, "gone", "start it"), 0.0)
    unwell.failed(Trouble("image refused", WARN, "mono16", "another topic"), 0.0)

    assert (told(well).level, told(well).message) == (OK, "all is well")
    assert told(well).values == {"state": "working", "n": "1"}
    assert (told(well, note="no yaw").level, told(well, note="no yaw").message) == (WARN, "no yaw")
    assert told(well, now=20).level == STALE
    assert "the last came 10 s ago" in told(well, now=20).message
    assert "ros2 topic hz /image" in told(well, now=20).values["remedy"]
    assert told(well, now=4, last_image=None).level == OK  # it has only just begun
    assert "none has come" in told(well, last_image=None).message
    assert told(broken, now=20).message == "gone"  # worse than no images
    assert told(unwell, now=20).level == STALE
    assert told(unwell).values == {
        "state": "image refused",
        "remedy": "another topic",
        "failures_in_a_row": "1",
        "n": "1",
    }
