"""A shared encoder over HTTP: batches over all callers, bounds, the key, and every refusal in words."""

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

from schemas.image import Image
from schemas.inference import JSON_LENGTH, PIXELS, Tensor, packed, unpacked
from tests.http.shared_encoder import GatedEncoder, GatedSegmenter, ask, pixels, serving
from tests.waiting import until
from worker.encoders.color import ColorEncoder
from worker.service.encoding import MOST_SEGMENTED

KEY = "a key that the fleet shares"


@pytest.fixture
def encoder() -> GatedEncoder:
    return GatedEncoder()


@pytest.fixture
def client(encoder: GatedEncoder) -> Iterator[TestClient]:
    with serving(encoder) as one:
        yield one


def numbers_waiting(client: TestClient, count: int) -> None:
    until(lambda: client.app.state.shared.service.waiting >= count)  # type: ignore[attr-defined]


def test_layers_are_those_of_the_encoder_to_the_byte(client: TestClient, encoder: GatedEncoder) -> None:
    images = np.random.default_rng(3).integers(0, 256, (3, 64, 96, 3), np.uint8)

    answer = ask(client, images, id="7")

    assert answer.status_code == 200
    said, found = unpacked("outputs", answer.headers[JSON_LENGTH], answer.content)
    assert said["id"] == "7"
    assert said["model_name"] == f"color-{encoder.digest[:12]}"
    for number, field in enumerate(ColorEncoder().encode([Image.of(one) for one in images])):
        assert found["words"][number].tobytes() == field.layers["semantic"].tobytes()
        assert found["detail"][number].tobytes() == field.layers["detail"].tobytes()


def test_images_of_several_callers_go_through_the_network_together(client: TestClient, encoder: GatedEncoder) -> None:
    encoder.open.clear()
    with ThreadPoolExecutor(4) as nodes:
        first = nodes.submit(ask, client, pixels(1))
        until(lambda: encoder.batches == [[1]])
        answers = [first]
        for number in (2, 3, 4):
            answers.append(nodes.submit(ask, client, pixels(number)))
            numbers_waiting(client, number)
        encoder.open.set()
        found = [unpacked("outputs", a.result().headers[JSON_LENGTH], a.result().content)[1] for a in answers]

    assert encoder.batches == [[1], [2, 3, 4]]
    expected = [next(ColorEncoder().encode([Image.of(pixels(n)[0])])).semantic for n in (1, 2, 3, 4)]
    for one, semantic in zip(found, expected, strict=True):
        assert np.array_equal(one["words"][0], semantic)
    metrics = client.get("/metrics").text
    assert "revisit_encoder_batch_images_sum 4.0" in metrics
    assert "revisit_encoder_batch_images_count 2.0" in metrics
    assert "revisit_encoder_images_waiting 0.0" in metrics


def test_queries_go_before_enrolments_of_all_callers(client: TestClient, encoder: GatedEncoder) -> None:
    encoder.open.clear()
    with ThreadPoolExecutor(4) as nodes:
        running = nodes.submit(ask, client, pixels(1))
        until(lambda: encoder.batches == [[1]])
        enrolment = nodes.submit(ask, client, pixels(2, 3), parameters={"priority": 2})
        numbers_waiting(client, 3)
        query = nodes.submit(ask, client, pixels(4), parameters={"priority": 1})
        numbers_waiting(client, 4)
        encoder.open.set()
        assert {running.result().status_code, enrolment.result().status_code, query.result().status_code} == {200}

    assert encoder.batches == [[1], [4], [2, 3]]


def test_a_full_queue_is_refused_with_a_time_to_come_back_and_queries_have_a_queue_of_their_own(
    client: TestClient, encoder: GatedEncoder
) -> None:
    encoder.open.clear()
    with ThreadPoolExecutor(4) as nodes:
        waiting = [nodes.submit(ask, client, pixels(*range(8)), parameters={"priority": 2})]
        numbers_waiting(client, 8)

        refused = ask(client, pixels(9), parameters={"priority": 2})
        assert refused.status_code == 503
        assert int(refused.headers["retry-after"]) >= 1
        assert refused.headers["content-type"] == "application/problem+json"
        assert refused.json()["error"] == refused.json()["detail"]
        assert "8 images are waiting" in refused.json()["detail"]

        waiting.append(nodes.submit(ask, client, pixels(9)))
        numbers_waiting(client, 9)
        encoder.open.set()
        assert [one.result().status_code for one in waiting] == [200, 200]


def test_what_a_caller_no_longer_waits_for_is_not_encoded(client: TestClient, encoder: GatedEncoder) -> None:
    encoder.open.clear()
    with ThreadPoolExecutor(1) as nodes:
        running = nodes.submit(ask, client, pixels(1))
        until(lambda: encoder.batches == [[1]])
        late = ask(client, pixels(2, 3), parameters={"timeout": 50_000})
        encoder.open.set()
        assert running.result().status_code == 200

    assert late.status_code == 503
    assert "not done within 0.1 s" in late.json()["detail"] or "within 0.0 s" in late.json()["detail"]
    assert ask(client, pixels(4)).status_code == 200
    assert encoder.batches == [[1], [4]]


def test_an_image_that_kills_the_network_fails_alone(client: TestClient, encoder: GatedEncoder) -> None:
    encoder.open.clear()
    with ThreadPoolExecutor(3) as nodes:
        nodes.submit(ask, client, pixels(1))
        until(lambda: encoder.batches == [[1]])
        bad = nodes.submit(ask, client, pixels(99))
        numbers_waiting(client, 2)
        good = nodes.submit(ask, client, pixels(3))
        numbers_waiting(client, 3)
        encoder.open.set()
        assert (bad.result().status_code, good.result().status_code) == (500, 200)
    assert bad.result().json()["type"] == "urn:revisit:problem:internal"


def test_other_weights_are_an_unknown_model_and_it_says_which_there_are(
    client: TestClient, encoder: GatedEncoder
) -> None:
    answer = ask(client, pixels(1), "color-000000000000")

    assert answer.status_code == 404
    assert encoder.digest in answer.json()["error"]
    assert client.get("/v2/models/color-000000000000/ready").status_code == 404


@pytest.mark.parametrize(
    ("images", "further"),
    [
        (np.zeros((1, 33, 64, 3), np.uint8), {}),
        (np.zeros((1, 32, 64, 4), np.uint8), {}),
        (np.zeros((0, 32, 64, 3), np.uint8), {}),
        (np.zeros((1, 0, 64, 3), np.uint8), {}),
        (np.zeros((9, 32, 64, 3), np.uint8), {}),  # more than ever may wait
        (np.zeros((32, 64, 3), np.uint8), {}),
        (np.zeros((1, 32, 64, 3), np.float32), {}),
        (np.zeros((1, 32, 64, 3), np.uint8), {"name": "images"}),
        (np.zeros((1, 32, 64, 3), np.uint8), {"parameters": {"priority": "high"}}),
        (np.zeros((1, 32, 64, 3), np.uint8), {"parameters": {"timeout": -1}}),
        (np.zeros((1, 32, 64, 3), np.uint8), {"parameters": [1]}),
        (np.zeros((1, 32, 64, 3), np.uint8), {"outputs": [{"name": "scores"}]}),
        (np.zeros((1, 32, 64, 3), np.uint8), {"outputs": "words"}),
    ],
)
def test_what_cannot_be_encoded_is_refused(client: TestClient, images: Tensor, further: dict[str, object]) -> None:
    answer = ask(client, images, **further)  # type: ignore[arg-type]

    assert answer.status_code == 400
    assert answer.json()["type"] == "urn:revisit:problem:malformed-body"


TENSOR: dict[str, object] = {
    "name": PIXELS,
    "datatype": "UINT8",
    "shape": [1, 32, 32, 3],
    "parameters": {"binary_data_size": 3072},
}
LONG = 10**4000
ODD: dict[str, dict[str, object]] = {
    "a size with decimals": TENSOR | {"parameters": {"binary_data_size": 3072.0}},
    "a shape whose product has too many digits to show": TENSOR | {"shape": [LONG, LONG, LONG, 3]},
    "a shape of very many sides": TENSOR | {"shape": [1] * 30_000},
    "a name that is no text": TENSOR | {"name": "\ud800"},
    "a type that is long": TENSOR | {"datatype": ["UINT8"] * 5000},
    "a length of very many digits": {"length": "9" * 5000},
}


@pytest.mark.parametrize("odd", ODD)
def test_what_a_message_says_of_a_tensor_is_refused_in_few_words(client: TestClient, odd: str) -> None:
    head = json.dumps({"inputs": [ODD[odd]]}).encode()
    model = client.app.state.shared.service.model  # type: ignore[attr-defined]
    headers = {JSON_LENGTH: str(ODD[odd].get("length", len(head)))}
    answer = client.post(f"/v2/models/{model}/infer", content=head + bytes(3072), headers=headers)
    assert (answer.status_code, answer.json()["type"]) == (400, "urn:revisit:problem:malformed-body"), answer.text
    assert len(answer.content) < 2000


def test_a_time_beyond_all_numbers_is_refused(client: TestClient) -> None:
    refused = ask(client, pixels(1), parameters={"timeout": 10**400})
    assert (refused.status_code, "parameters.timeout" in refused.json()["error"]) == (400, True)


def test_one_output_can_be_wanted_alone(client: TestClient) -> None:
    answer = ask(client, pixels(1), outputs=[{"name": "detail", "parameters": {"binary_data": True}}])

    assert list(unpacked("outputs", answer.headers[JSON_LENGTH], answer.content)[1]) == ["detail"]


def test_a_body_that_is_too_large_is_refused_before_it_is_read(encoder: GatedEncoder) -> None:
    with serving(encoder, max_body_mb="0.1") as client:
        assert ask(client, pixels(*range(8), side=320)).status_code == 413


def test_it_says_what_it_is_as_the_protocol_has_it(client: TestClient, encoder: GatedEncoder) -> None:
    model = client.app.state.shared.service.model  # type: ignore[attr-defined]

    assert "binary_tensor_data" in client.get("/v2").json()["extensions"]
    facts = client.get(f"/v2/models/{model}").json()
    assert facts["inputs"] == [{"name": "pictures", "datatype": "UINT8", "shape": [-1, -1, -1, 3]}]
    assert [(one["name"], one["shape"][-1]) for one in facts["outputs"]] == [("words", 8), ("detail", 12)]
    for path in ("/livez", "/readyz", "/v2/health/live", "/v2/health/ready", f"/v2/models/{model}/ready"):
        assert client.get(path).status_code == 200


def test_only_who_has_the_key_is_let_in(encoder: GatedEncoder) -> None:
    with serving(encoder, encoder_key=KEY.replace(" ", "-")) as client:
        assert ask(client, pixels(1)).status_code == 401
        assert client.get("/metrics").status_code == 401
        assert client.get("/v2").status_code == 401
        assert client.get("/readyz").status_code == 200
        client.headers["authorization"] = "Bearer another-key-of-some-length"
        refused = ask(client, pixels(1))
        assert refused.status_code == 401
        assert "REVISIT_ENCODER_KEY" in refused.json()["detail"]
        assert refused.headers["www-authenticate"].startswith("Bearer")
        client.headers["authorization"] = f"Bearer {KEY.replace(' ', '-')}"
        assert ask(client, pixels(1)).status_code == 200
        assert client.get("/metrics").status_code == 200
    assert encoder.batches == [[127], [1]]


SEGMENTER = "color-segmenter-dddddddddddd"


def segmented(
    client: TestClient, scales: Sequence[Tensor], rows: object = 3, columns: object = 4, **parameters: object
) -> httpx.Response:
    inputs = {f"pictures.{number}": scale for number, scale in enumerate(scales)}
    told = {"parameters": {"rows": rows, "columns": columns, **parameters}}
    length, body = packed("inputs", inputs, told)
    headers = {JSON_LENGTH: str(length), "content-type": "application/octet-stream"}
    answer: httpx.Response = client.post(f"/v2/models/{SEGMENTER}/infer", content=body, headers=headers)
    return answer


SCALES = pixels(1), pixels(2, side=64)


def test_an_image_is_segmented_from_its_scales(encoder: GatedEncoder) -> None:
    segmenter = GatedSegmenter()
    with serving(encoder, segmenter=segmenter) as client:
        answer = segmented(client, SCALES, priority=2)
        assert answer.status_code == 200, answer.text
        said, found = unpacked("outputs", answer.headers[JSON_LENGTH], answer.content)
        assert said["model_name"] == SEGMENTER
        assert found["segmentation"].shape == (1, 3, 4, 2)
        assert found["segmentation"][0, 0, 0].tolist() == [1, 2]
        assert segmenter.urgent == [False]
        told = client.get(f"/v2/models/{SEGMENTER}").json()
        assert [one["name"] for one in told["inputs"]] == ["pictures.0", "pictures.1"]
        assert [one["name"] for one in told["outputs"]] == ["segmentation"]
        assert client.get(f"/v2/models/{client.app.state.shared.service.model}").json()["inputs"][0]["name"] == PIXELS  # type: ignore[attr-defined]


def test_nothing_waits_for_a_drawing_and_few_drawings_wait(
    encoder: GatedEncoder, monkeypatch: pytest.MonkeyPatch
) -> None:
    segmenter = GatedSegmenter()
    segmenter.open.clear()
    with serving(encoder, segmenter=segmenter) as client, ThreadPoolExecutor(MOST_SEGMENTED) as nodes:
        waiting = [nodes.submit(segmented, client, SCALES) for _ in range(MOST_SEGMENTED)]
        numbers_waiting(client, MOST_SEGMENTED)
        assert ask(client, pixels(7)).status_code == 200
        refused = segmented(client, SCALES)
        assert refused.status_code == 503
        assert "8 segmentations are waiting" in refused.json()["error"]
        assert int(refused.headers["retry-after"]) >= 1
        assert client.get("/livez").status_code == 200
        with monkeypatch.context() as soon:
            soon.setattr("worker.description.scheduler.HANGS_S", 0.0)
            hanging = client.get("/livez")
            assert (hanging.status_code, hanging.text[:40]) == (503, "the segmenter has been at one image for ")
        segmenter.open.set()
        assert {one.result().status_code for one in waiting} == {200}
        until(lambda: client.app.state.shared.service.waiting == 0)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("scales", "rows", "why"),
    [
        (SCALES[:1], 3, "needed are the inputs pictures.0, pictures.1"),
        ((*SCALES, pixels(3)), 3, "needed are the inputs"),
        ((pixels(1, 1), pixels(2)), 3, "shape (1, height, width, 3)"),
        ((pixels(1), pixels(2)[:, :31]), 3, "multiples of 32"),
        ((pixels(1)[:, :0], pixels(2)), 3, "the shape of pictures.0 is [1, 0, 64, 3]"),
        (SCALES, 0, "are 1 to 256, not 0 and 4"),
        (SCALES, 257, "not 257 and 4"),
        (SCALES, "3", "parameters.rows is a number"),
    ],
)
def test_what_cannot_be_segmented_is_refused_in_words(
    encoder: GatedEncoder, scales: Sequence[Tensor], rows: object, why: str
) -> None:
    with serving(encoder, segmenter=GatedSegmenter()) as client:
        answer = segmented(client, scales, rows)
    assert answer.status_code == 400
    assert why in answer.json()["error"]


def test_without_a_segmenter_there_is_no_such_model(client: TestClient) -> None:
    answer = segmented(client, SCALES)
    assert answer.status_code == 404
    assert "and no segmenter" in answer.json()["error"]
