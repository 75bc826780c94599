"""Examples for the OpenAPI document; tests compare them with the models and the table of problems."""

from typing import Any

VIEW: dict[str, Any] = {
    "id": "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90",
    "map": "campus",
    "place": "library entrance",
    "position": {"x": 12.5, "y": 3.0, "z": None, "lat": None, "lon": None, "alt": None, "heading": 90.0},
    "captured_at": "2026-03-01T09:30:00.000000Z",
    "enrolled_at": "2026-03-01T09:30:02.118000Z",
    "metadata": {"camera": "front"},
    "filename": "IMG_2041.jpg",
    "image": {
        "width": 1280,
        "height": 720,
        "bytes": 184213,
        "format": "jpeg",
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    },
    "state": "ready",
    "failure": None,
    "description": {
        "recipe": "4c1d9ab02e7f6a35",
        "sampled_descriptors": 1860,
        "static_share": 0.93,
        "labels": [{"label": "building", "share": 0.58}, {"label": "tree", "share": 0.22}],
        "nodes": 11,
    },
    "links": {
        "self": "/views/0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90",
        "image": "/views/0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90/image",
        "thumbnail": "/views/0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90/thumbnail",
        "segmentation": "/views/0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90/segmentation.png",
        "graph": "/views/0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90/graph.png",
    },
}

ENROLLED: dict[str, Any] = {
    "view": VIEW,
    "created": True,
    "revision": 42,
    "job": None,
    "timing_ms": {"decode": 6.1, "describe": 48.0, "store": 3.9, "total": 59.2},
}

MATCH: dict[str, Any] = {
    "rank": 1,
    "view": VIEW,
    "score": 0.83,
    "confidence": 0.97,
    "parts": {"dense": 0.09, "dense_full": 0.62, "graph": 0.02, "verification": 0.1},
    "channels": {"semantic": {"distance": 0.41, "rank": 1}, "detail": {"distance": 0.52, "rank": 2}},
    "dense": {"similarity": 0.88, "median_similarity": 0.31, "p85_similarity": 0.44, "shift": [0, 1], "scale": 1.02},
    "graph": {
        "similarity": 0.64,
        "correspondences": 7,
        "nodes_query": 10,
        "nodes_view": 11,
        "edges_agreeing": 9,
        "pairs": None,
    },
    "verification": {"inliers": 61, "matches": 88, "transform": [[1.0, 0.02, 0.01], [-0.02, 1.0, 0.0]], "pairs": None},
    "links": {
        "image": VIEW["links"]["image"],
        "thumbnail": VIEW["links"]["thumbnail"],
        "explanation": None,
    },
}

QUERY_ANSWER: dict[str, Any] = {
    "query": {
        "id": "0195f2b1-02aa-7d01-8c3e-5d1f7a9b3c44",
        "width": 1280,
        "height": 720,
        "labels": [{"label": "building", "share": 0.55}],
        "static_share": 0.9,
        "fixed_share": 0.0,
    },
    "map": "campus",
    "revision": 42,
    "recipe": "4c1d9ab02e7f6a35",
    "ranking": "97b1f2c0d3e4a586",
    "searched": 1730,
    "pending": 0,
    "maps": None,
    "drive": None,
    "changes": None,
    "status": "matched",
    "confidence": 0.97,
    "reason": {"code": "sure", "detail": "one place stands out from all others", "remedy": "nothing", "rival": None},
    "places": [
        {
            "map": VIEW["map"],
            "place": VIEW["place"],
            "position": VIEW["position"],
            "probability": 0.97,
            "views": [{"id": VIEW["id"], "score": 0.83}],
        }
    ],
    "nowhere": 0.03,
    "decision": {
        "precision": 0.97,
        "threshold": 0.93,
        "features": {"gap": 1.9, "level": 0.0, "breadth": 1.2, "own": 0.4, "either": 1.7},
        "wrong_score": 0.31,
        "wrong_gap": 0.03,
        "wrong_breadth": 2.1,
        "own_score": 0.72,
        "views_compared": 1730,
    },
    "matches": [MATCH],
    "estimate": {"position": VIEW["position"], "radius_m": 2.5, "views": [VIEW["id"]]},
    "timing_ms": {"decode": 6.0, "queue": 0.1, "encode": 41.0, "describe": 3.2, "search": 0.8, "total": 58.3},
}

PATCH: dict[str, Any] = {"place": "library, east door", "position": {"heading": 95}, "metadata": {"camera": None}}

POST_CALIBRATION: dict[str, Any] = {
    "observed": [
        {
            "features": {"gap": 1.9, "level": 0.0, "breadth": 1.2, "own": 0.4, "either": 1.7},
            "right": True,
            "block": "monday",
        },
        {
            "features": {"gap": 0.2, "level": -0.4, "breadth": 0.3, "own": 0.1, "either": 0.4},
            "right": False,
            "known": False,
            "block": "tuesday",
        },
    ],
    "queries": [{"view": VIEW["id"], "place": VIEW["place"]}],
}


def _rate(count: int, of: int, lowest: float, highest: float, per: float = 1.0) -> dict[str, Any]:
    return {"value": per * count / of, "interval": [lowest, highest], "count": count, "of": of}


CALIBRATION_REPORT: dict[str, Any] = {
    "map": "campus",
    "revision": 43,
    "kept": True,
    "transfers": True,
    "detail": "it does better on held-out queries than the shipped calibration, and decides from now on",
    "queries": 240,
    "unanswered": 0,
    "right": 150,
    "unknown": 60,
    "blocks": 20,
    "folds": 5,
    "precision": 0.97,
    "shipped": {
        "log_loss": 0.38,
        "expected_error": 0.11,
        "precision": _rate(62, 64, 0.893, 0.991),
        "matched_share": _rate(62, 150, 0.338, 0.493),
        "false_accepts_per_1000": _rate(1, 60, 2.9, 88.6, 1000),
    },
    "own": {
        "log_loss": 0.29,
        "expected_error": 0.05,
        "precision": _rate(105, 107, 0.934, 0.995),
        "matched_share": _rate(105, 150, 0.622, 0.768),
        "false_accepts_per_1000": _rate(1, 60, 2.9, 88.6, 1000),
    },
    "thresholds": [{"precision": 0.97, "threshold": 0.81, "matched_share": 0.7}],
}

MAP_HEALTH: dict[str, Any] = {
    "map": "campus",
    "revision": 43,
    "views": 1730,
    "examined": 1730,
    "compared": 1730,
    "counts": {
        "twins": 0,
        "ageing": 0,
        "never-matched": 0,
        "duplicates": 0,
        "missing-directions": 1,
        "single-view": 0,
        "gap": 0,
    },
    "findings": [
        {
            "code": "missing-directions",
            "detail": "'library, east door' is not seen towards south and west",
            "remedy": "stand at 'library, east door' (x 12.5, y 3.0), photograph south (180°) and west (270°)",
            "places": ["library, east door"],
            "views": [VIEW["id"], "0195f2a5-1b02-7c44-8e10-6d3b9a7c5f21"],
            "count": 2,
            "position": {**VIEW["position"], "heading": 45.0},
            "headings": [180.0, 270.0],
        }
    ],
}

PROBLEM_DETAILS: dict[str, str] = {
    "damaged": "the file pictures/9f/86/9f86d081 of its image is empty; enrol the image again, or restore the file "
    "from a backup",
    "no-picture": "the body is empty; send the image as the multipart part `image`",
    "malformed-body": "the multipart body breaks off before its closing boundary",
    "bad-request": "the request cannot be understood",
    "unexpected-body": "GET /views takes no body, and one of 12 bytes was sent",
    "unauthorized": "this service needs a key",
    "forbidden": "the key reads the map 'campus' and may not write to it",
    "other-site": "a page of https://shop.example sent this, and pages of other sites may not write to a service "
    "without keys; name its origin in REVISIT_CORS, or send a key",
    "not-found": "there is no view '0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90'",
    "image-not-kept": "the map of the view 0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90 keeps no images: this one was removed "
    "when it was described",
    "no-pose": "another place is nearly as good; look at the rival",
    "method-not-allowed": "/query does not answer GET",
    "request-timeout": "the body did not arrive within 30 s; 4,096 bytes of it did",
    "conflict": "these bytes are in the map already with the place 'hall'; PATCH the view to change its attributes",
    "body-too-large": "the body has 31,457,280 bytes; at most 25,000,000 are taken",
    "not-a-picture": "this seems to be a PDF; send an image as jpeg, png, webp, bmp, tiff or heic",
    "range-not-satisfiable": "the file has 1,048,576 bytes, and none of those that `Range` names",
    "invalid-parameter": "top: Input should be less than or equal to 100 (got '500')",
    "undecodable-picture": "this jpeg image cannot be decoded: it ends before the image does",
    "picture-too-large": "the image is 12000 x 9000 = 108.0 megapixels; at most 50 are taken",
    "picture-too-small": "the image is 31 x 32 pixels; at least 32 x 32 are needed",
    "poor-picture": "the image is blurred (sharpness 9; photos of places have hundreds)",
    "nothing-static": "every cell of the image shows something that moves",
    "idempotency-key-reused": "this Idempotency-Key was used for another request",
    "too-many-requests": "1000 images wait to be described, as many as are let in; try in 61 s",
    "headers-too-large": "request line and headers have more than 65,536 bytes",
    "internal": "something went wrong inside the service; its log has the reason under this request id",
    "unavailable": "the service is starting",
    "disk-full": "the disk is full; deleting and reading still work",
}
