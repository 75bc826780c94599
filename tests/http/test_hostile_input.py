"""Any bytes give an image or an error with a code: no other exception, no crash, no long wait."""

import asyncio
import io
import json
import struct
import time
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from PIL import Image as PilImage
from starlette.requests import Request

from app.http.body import LARGEST_JSON, MOST_IMAGES, Sent, json_object, take
from app.http.idempotency import fingerprint
from app.http.merge_patch import merge
from app.http.parameters import (
    AttributesDocument,
    DeleteViews,
    EnrollParameters,
    ListViews,
)
from app.http.problems import KINDS, code_of
from app.http.query_parameters import QueryParameters
from app.http.validation import read, validated
from schemas.errors import InvalidParameters, RevisitError
from tests.sample_images import PNG_MAGIC, drawn, encoded, png_chunk
from worker.images.codec import Limits, decode, probe, thumbnail
from worker.images.sniffing import image_type

LIMITS = Limits(max_bytes=1_000_000, max_pixels=500_000)
FORMS = ("jpeg", "png", "webp", "bmp", "tiff")
SOUND = {form: encoded(drawn(96, 64), form) for form in FORMS}
SOUND["exif"] = encoded(drawn(96, 64), "jpeg", exif=(exif := PilImage.Exif()))
SOUND["progressive"] = encoded(drawn(96, 64), "jpeg", progressive=True)

# Pillow warns of odd metadata and goes on; only the outcome is tested here.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:PIL")

many = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def outcome(data: bytes) -> str:
    """``image``, or the code of the refusal; anything else raises."""
    try:
        image = decode(data, LIMITS)
    except RevisitError as error:
        assert code_of(error) != "internal", error
        return error.code
    facts = probe(data, LIMITS)
    assert (facts.width, facts.height, facts.sha256) == (image.width, image.height, image.digest)
    assert image.width * image.height <= LIMITS.max_pixels
    assert thumbnail(data, 32)
    return "image"


# images


@many
@given(
    form=st.sampled_from(sorted(SOUND)),
    changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=6),
    keep=st.floats(0, 1),
    tail=st.binary(max_size=20),
)
def test_a_damaged_image_is_an_image_or_a_refusal(
    form: str, changes: list[tuple[float, int]], keep: float, tail: bytes
) -> None:
    data = bytearray(SOUND[form])
    for position, value in changes:
        data[int(position * len(data))] = value
    outcome(bytes(data[: int(keep * len(data)) if keep < 0.9 else len(data)]) + tail)


@many
@given(form=st.sampled_from(sorted(SOUND)), position=st.integers(0, 200), value=st.integers(0, 255))
def test_a_damaged_header_is_an_image_or_a_refusal(form: str, position: int, value: int) -> None:
    data = bytearray(SOUND[form])
    data[min(position, len(data) - 1)] = value
    outcome(bytes(data))


@many
@given(
    magic=st.sampled_from(
        [b"", b"\xff\xd8\xff\xe0", PNG_MAGIC, b"BM", b"II*\x00", b"MM\x00*", b"RIFF\0\0\0\0WEBPVP8L"]
    ),
    rest=st.binary(max_size=400),
)
def test_rubbish_behind_any_magic_is_refused(magic: bytes, rest: bytes) -> None:
    assert outcome(magic + rest) in ("not-a-picture", "undecodable-picture", "picture-too-large", "picture-too-small")


@pytest.mark.parametrize("form", FORMS)
def test_an_image_cut_at_every_byte_is_refused(form: str) -> None:
    data = SOUND[form]
    step = max(1, len(data) // 150)
    # The last bytes of a BMP are padding, those of a WebP may be; every other cut loses pixels.
    for cut in range(0, len(data) - 16, step):
        assert outcome(data[:cut]) in ("not-a-picture", "undecodable-picture"), cut


@pytest.mark.parametrize(
    ("width", "height"), [(0, 0), (0, 100), (1, 2**31 - 1), (2**31 - 1, 2**31 - 1), (40_000, 40_000), (2**16, 2**16)]
)
@pytest.mark.parametrize("form", ["png", "bmp", "tiff"])
def test_sizes_that_lie_are_refused_without_taking_memory(form: str, width: int, height: int) -> None:
    data = bytearray(SOUND[form])
    if form == "png":
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif form == "bmp":
        data[18:26] = struct.pack("<ii", width, height)
    else:
        data = bytearray(data.replace(struct.pack("<HHIHH", 256, 4, 1, 96, 0), struct.pack("<HHII", 256, 4, 1, width)))
        data = bytearray(data.replace(struct.pack("<HHIHH", 257, 4, 1, 64, 0), struct.pack("<HHII", 257, 4, 1, height)))
    begin = time.perf_counter()
    assert outcome(bytes(data)) in ("undecodable-picture", "picture-too-large", "picture-too-small")
    assert time.perf_counter() - begin < 5


def test_text_in_an_image_that_unpacks_to_gigabytes_does_no_harm() -> None:
    bomb = zlib.compress(bytes(50_000_000), 9)
    sound = SOUND["png"]
    for kind, head in ((b"zTXt", b"Comment\0\0"), (b"iCCP", b"profile\0\0"), (b"iTXt", b"Comment\0\1\0\0\0")):
        data = sound[:33] + png_chunk(kind, head + bomb) + sound[33:]
        begin = time.perf_counter()
        outcome(data)
        assert time.perf_counter() - begin < 5


def test_a_tiff_whose_directory_points_to_itself_ends() -> None:
    data = bytearray(SOUND["tiff"])
    at = struct.unpack("<I", data[4:8])[0]
    entries = struct.unpack("<H", data[at : at + 2])[0]
    data[at + 2 + 12 * entries : at + 6 + 12 * entries] = struct.pack("<I", at)
    outcome(bytes(data))


def test_exif_that_is_long_or_deep_does_no_harm() -> None:
    rng = np.random.default_rng(3)
    for length in (6, 20, 1000, 60_000):
        outcome(encoded(drawn(96, 64), "jpeg", exif=b"Exif\0\0" + rng.integers(0, 256, length, np.uint8).tobytes()))


@given(st.binary(max_size=600))
def test_everything_has_a_type_or_a_reason(data: bytes) -> None:
    try:
        assert image_type(data) in FORMS
    except RevisitError as error:
        assert error.code == "not-a-picture"
        assert "seems to be" in error.detail


# bodies


def request(body: bytes, content_type: str, query: str = "", chunk: int = 1000) -> Request:
    chunks = [body[i : i + chunk] for i in range(0, len(body), chunk)] or [b""]
    messages = [{"type": "http.request", "body": c, "more_body": i + 1 < len(chunks)} for i, c in enumerate(chunks)]

    async def receive() -> Any:
        return messages.pop(0)

    headers = [(b"content-type", content_type.encode("latin-1"))] if content_type else []
    scope = {"type": "http", "method": "POST", "path": "/", "query_string": query.encode(), "headers": headers}
    return Request(scope, receive)


def taken(body: bytes, content_type: str, query: str = "") -> Sent | str:
    try:
        return asyncio.run(take(request(body, content_type, query)))
    except RevisitError as error:
        assert error.code in KINDS
        return error.code


FORM = "multipart/form-data; boundary=xyz"


def part(name: str, content: bytes, file: str | None = None) -> bytes:
    file = "" if file is None else f'; filename="{file}"'
    return f'--xyz\r\nContent-Disposition: form-data; name="{name}"{file}\r\n\r\n'.encode() + content + b"\r\n"


WHOLE = part("image", b"picture", "a.jpg") + part("map", b"m") + part("metadata", b'{"a": 1}') + b"--xyz--\r\n"


def test_a_whole_body_is_parsed() -> None:
    sent = taken(b"preamble\r\n" + WHOLE + b"epilogue", FORM, "place=p")
    if isinstance(sent, str):
        sent = taken(WHOLE, FORM, "place=p")
    assert isinstance(sent, Sent)
    assert sent.images == [("a.jpg", b"picture")]
    assert sent.parameters == [("place", "p"), ("map", "m"), ("metadata", '{"a": 1}')]


def test_no_part_is_lost_behind_a_damaged_boundary() -> None:
    """What stands before the first boundary says nothing, and an image decodes whatever follows it."""
    for number in range(WHOLE.count(b"--xyz\r\n")):
        at = -1
        for _ in range(number + 1):
            at = WHOLE.index(b"--xyz\r\n", at + 1)
        for changed in range(at, at + 5):
            damaged = WHOLE[:changed] + b"?" + WHOLE[changed + 1 :]
            assert taken(b"\r\n" + damaged, FORM) == "malformed-body", (number, changed)


def test_a_body_cut_at_every_byte_is_malformed() -> None:
    # The closing boundary is --xyz--; the line end behind it may be missing.
    for cut in range(1, len(WHOLE) - 2):
        assert taken(WHOLE[:cut], FORM) == "malformed-body", cut
    assert isinstance(taken(WHOLE[:-2], FORM), Sent)


@many
@given(
    changes=st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.binary(max_size=4)), max_size=4),
    content_type=st.sampled_from(
        [FORM, FORM + "; charset=utf-16", 'multipart/form-data; boundary="x y"', "multipart/form-data"]
    ),
)
def test_a_damaged_body_is_parsed_or_refused(changes: list[tuple[int, bytes]], content_type: str) -> None:
    body = WHOLE
    for position, what in changes:
        body = body[:position] + what + body[position + 1 :]
    sent = taken(body, content_type)
    if isinstance(sent, Sent):
        assert all(data for _, data in sent.images)


@many
@given(
    content_type=st.text(st.characters(max_codepoint=255, exclude_characters="\r\n\0"), max_size=60),
    body=st.binary(max_size=80),
)
def test_any_content_type_is_taken_or_refused(content_type: str, body: bytes) -> None:
    taken(body, content_type)
    taken(body, "multipart/form-data; " + content_type)


def test_an_image_that_looks_like_boundaries_arrives_whole() -> None:
    for image in (b"\r\n--xy", b"--xyz", b"\r\n--xyzz", b"\r\n" * 50, b"\r\n--xyz-", b"\r" * 99, b"--"):
        sent = taken(part("image", image) + b"--xyz--", FORM)
        assert isinstance(sent, Sent)
        assert sent.images == [(None, image)]


def test_a_body_of_near_boundaries_takes_no_minute() -> None:
    image = b"\r\n--xyz?" * 200_000
    begin = time.perf_counter()
    sent = taken(part("image", image) + b"--xyz--", FORM)
    assert isinstance(sent, Sent)
    assert sent.images[0][1] == image
    assert time.perf_counter() - begin < 20


def test_headers_of_a_part_that_never_end_are_refused() -> None:
    for header in (b"X-A: " + b"a" * 100_000, b"X-A: 1\r\n" * 5000):
        assert taken(b"--xyz\r\n" + header + b"\r\n\r\npicture\r\n--xyz--", FORM) == "malformed-body"


def test_more_than_a_hundred_images_are_refused() -> None:
    sent = taken(part("image", b"p") * (MOST_IMAGES + 1) + b"--xyz--", FORM)
    assert isinstance(sent, Sent)
    assert [error.parameter for error in sent.errors] == ["image"]


def test_names_of_parts_are_shown_and_never_trusted() -> None:
    for name in ("../../etc/passwd", "a" * 500, "ü", "image[]", "Image", ""):
        assert taken(part(name, b"x", "a.jpg") + b"--xyz--", FORM) == "invalid-parameter"


# JSON


@many
@given(st.binary(max_size=200))
def test_any_bytes_are_an_object_or_malformed(body: bytes) -> None:
    try:
        assert isinstance(asyncio.run(json_object(request(body, "application/json"))), dict)
    except RevisitError as error:
        assert error.code == "malformed-body"


@pytest.mark.parametrize("opening", [b"[", b'{"a":', b'[{"a":'])
def test_deep_json_is_refused_before_it_is_deep(opening: bytes) -> None:
    with pytest.raises(RevisitError):
        asyncio.run(json_object(request(opening * (LARGEST_JSON // 8), "application/json")))


def test_a_number_of_very_many_digits_is_refused_in_words() -> None:
    with pytest.raises(RevisitError, match=r"the number 1{40}… of 5000 digits; at most 4300 are taken"):
        asyncio.run(json_object(request(b'{"x": ' + b"1" * 5000 + b"}", "application/json")))


values_ = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=12,
)
fields = st.sampled_from(["place", "x", "y", "z", "lat", "lon", "alt", "heading", "captured_at", "metadata", "odd"])


@many
@given(st.dictionaries(fields, values_, max_size=5))
def test_any_document_gives_its_attributes_or_a_list_of_mistakes(document: dict[str, Any]) -> None:
    try:
        attributes = validated(AttributesDocument, document).attributes()
    except InvalidParameters as error:
        assert error.errors
        assert all(one.detail for one in error.errors)
    else:
        json.dumps(dict(attributes.metadata), allow_nan=False).encode()


texts = st.text(max_size=30) | st.sampled_from(
    ["1", "-1", "nan", "1e400", "0x10", "1_0", "true", "2026-01-01T00:00:00Z", "1,2,3", "{}"]
)
MODELS = (EnrollParameters, QueryParameters, ListViews, DeleteViews)


@many
@given(
    model=st.sampled_from(MODELS),
    pairs=st.lists(
        st.tuples(st.sampled_from(sorted({n for m in MODELS for n in m.model_fields} | {"metadata.a", "odd"})), texts),
        max_size=6,
    ),
)
def test_any_parameters_are_read_or_named(model: Any, pairs: list[tuple[str, str]]) -> None:
    try:
        read(model, pairs)
    except InvalidParameters as error:
        names = {name for name, _ in pairs} | set(model.model_fields)
        assert {one.parameter.partition(".")[0] for one in error.errors} <= {n.partition(".")[0] for n in names}


@given(values_, values_)
def test_a_merge_keeps_what_the_patch_does_not_name(target: Any, patch: Any) -> None:
    merged = merge(target, patch)
    if isinstance(patch, dict) and isinstance(target, dict):
        assert {k: v for k, v in merged.items() if k not in patch} == {
            k: v for k, v in target.items() if k not in patch
        }
        assert not any(value is None and key in merged for key, value in patch.items())


def test_fingerprints_tell_requests_apart() -> None:
    prints = [
        fingerprint([b"a"], []),
        fingerprint([b"b"], []),
        fingerprint([b"a", b"b"], []),
        fingerprint([b"b", b"a"], []),
        fingerprint([b"ab"], []),
        fingerprint([b"a"], [("map", "m")]),
        fingerprint([b"a"], [("map", "m"), ("place", "p")]),
    ]
    assert len(set(prints)) == len(prints)
    assert fingerprint([b"a"], [("x", "1"), ("y", "2")]) == fingerprint([b"a"], [("y", "2"), ("x", "1")])


def test_an_image_of_one_colour_survives_every_format() -> None:
    for form in FORMS:
        out = io.BytesIO()
        PilImage.new("RGB", (40, 40), (7, 7, 7)).save(out, form)
        assert outcome(out.getvalue()) == "image"
