"""Answers of a fake service, for tests of the client and of the command line."""

from typing import Any

ID = "01890a5d-ac96-774b-bcce-b302099a8057"
JOB = "01890a5d-ac96-774b-bcce-b302099a8058"
NOON = "2026-03-01T12:00:00.000000Z"


def view(view_id: str = ID, **changes: Any) -> dict[str, Any]:
    """A view, as JSON."""
    return {
        "id": view_id,
        "map": "default",
        "place": "square",
        "position": {"x": 1.0, "y": 2.0, "z": None, "lat": None, "lon": None, "alt": None, "heading": None},
        "captured_at": None,
        "enrolled_at": NOON,
        "metadata": {},
        "image": {"width": 640, "height": 480, "bytes": 1000, "format": "png", "sha256": "0" * 64},
        "state": "ready",
        "failure": None,
        "description": {"recipe": "r", "sampled_descriptors": 10, "static_share": 1.0, "labels": [], "nodes": 2},
        "links": {"self": "/s", "image": "/i", "thumbnail": "/t", "segmentation": "/g", "graph": "/h"},
    } | changes


def enrolled(created: bool = True, **changes: Any) -> dict[str, Any]:
    """What `POST /enroll` answers."""
    return {"view": view(**changes), "created": created, "revision": 1, "job": None, "timing_ms": {"total": 5.0}}


def match(rank: int = 1, score: float = 0.8, **changes: Any) -> dict[str, Any]:
    """One match of a query's answer."""
    return {
        "rank": rank,
        "view": view(**changes),
        "score": score,
        "confidence": 0.93,
        "parts": {"dense": score},
        "channels": {"semantic": {"distance": 0.4, "rank": rank}},
        "dense": None,
        "graph": None,
        "verification": {"inliers": 40, "matches": 60, "transform": None, "pairs": None},
        "links": {"image": "/i", "thumbnail": "/t", "explanation": None},
    }


def query_answer(*matches: dict[str, Any], status: str = "matched") -> dict[str, Any]:
    """What `POST /query` answers."""
    return {
        "query": {"id": "q1", "width": 640, "height": 480, "labels": [], "static_share": 1.0},
        "map": "default",
        "revision": 3,
        "recipe": "r",
        "ranking": "k",
        "searched": 3,
        "pending": 0,
        "status": status,
        "confidence": 0.93,
        "reason": {"code": "sure" if status == "matched" else "weak", "detail": "seen so", "remedy": "do this"},
        "places": [],
        "nowhere": 0.07,
        "decision": {
            "precision": 0.97,
            "threshold": 0.9,
            "features": {"gap": 1.5, "level": 0.0},
            "wrong_score": 0.3,
            "wrong_gap": 0.03,
            "views_compared": 3,
        },
        "matches": list(matches),
        "estimate": None,
        "timing_ms": {"total": 12.0},
    }


def map_facts(name: str = "default") -> dict[str, Any]:
    """A map."""
    return {
        "name": name,
        "revision": 3,
        "views": {"pending": 0, "ready": 3, "failed": 0},
        "places": 2,
        "bytes": 3000,
        "recipe": {"id": "abc", "encoder": "compact"},
        "ranking": {"id": "def", "preset": "default"},
        "decision": {
            "source": "own-views",
            "views_compared": 3,
            "expected": {"precision": 0.97, "matched_share": 0.5},
            "updated_at": "2026-03-01T09:30:00Z",
        },
        "labels": [
            {"index": 0, "label": "sky", "mapped_to": ["sky"], "trained": True, "dynamic": False, "colour": "#4682b4"}
        ],
        "vocabulary": {},
        "extent": None,
        "created_at": NOON,
    }


def job(state: str = "done", **changes: Any) -> dict[str, Any]:
    """A job."""
    return {
        "id": JOB,
        "kind": "describe",
        "state": state,
        "map": "default",
        "view": ID,
        "attempts": 1,
        "progress": None,
        "result": None,
        "created_at": NOON,
        "finished_at": None,
        "failure": None,
        "links": {},
    } | changes


def problem(code: str = "not-found", status: int = 404, **changes: Any) -> dict[str, Any]:
    """A refusal."""
    return {
        "type": f"urn:revisit:problem:{code}",
        "title": "There is no such thing",
        "status": status,
        "detail": "there is no map 'x'",
        "errors": [],
        "request_id": "abc",
    } | changes
