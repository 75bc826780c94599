"""The only file of the golden tests with names of the product; the others use neutral names.

Nearly everything goes through the HTTP interface, except descriptions as arrays and the interruption of queries.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from fastapi.testclient import TestClient

from app.http.application import create_app
from scenes import scene
from schemas.settings import Settings
from tests import sample_images
from tests.waiting import PATIENCE_S
from worker.runtime import build

EncoderName = Literal["color", "compact"]
Evidence = dict[str, Any]
Pixels = npt.NDArray[np.uint8]

encoded = sample_images.encoded
blobs = sample_images.drawn

CHANNELS = {"semantic": "semantic", "detail": "detail"}
TERMS = ("dense_full", "dense", "histogram.semantic", "histogram.detail", "graph", "verification")

DESCRIPTION: Mapping[str, tuple[str, ...]] = {
    "dense_cells": ("dense",),
    "local_features": ("local_features",),
    "min_region_cells": ("graph", "min_region_cells"),
    "dynamic_margin": ("dynamic", "margin"),
    "channel_weights": ("dense", "channel_weights"),
}
"""Description parameters: neutral name to path in the product's parameters."""

RANKING: Mapping[str, str] = {
    "candidates": "candidates",
    "ranking": "mode",
    "full_resolution_top_k": "full_resolution_top_k",
    "detail_only_top_k": "detail_only_top_k",
    "scale_penalty": "scale_penalty",
    "verification_top_k": "verified_top_k",
    "graph_cosine": "graph_cosine",
    "graph_tau": "graph_max_edge",
}
"""Ranking parameters: neutral name to the product's."""

OF_CHANNELS = {"assignments": "assignments", "vocabulary_size": "vocabulary_size", "sampled_descriptors": "descriptors"}
"""Parameters of each channel: neutral name to the product's."""

STAGES = {
    "search": ("catalogue", "index"),
    "catch_up": ("store.descriptions", "since"),
    "half_resolution": ("store.descriptions", "appearances"),
    "full_resolution": ("store.descriptions", "cells"),
    "local_features": ("store.descriptions", "local_features"),
    "views": ("store.views", "at"),
}
"""Calls of a query in their order, at which it can be interrupted: (part of the runtime, method)."""

DENSE = {"similarity": "similarity", "median_similarity": "median_similarity", "p85_similarity": "p85_similarity"}


@dataclass(frozen=True)
class View:
    """An image to enrol and its attributes; `name` is its name in answers."""

    name: str
    image: bytes
    place: str | None = None
    position: Mapping[str, float] = field(default_factory=dict)
    captured_at: str | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MapOptions:
    """Recipe of a map; `numbers` by the names in DESCRIPTION, RANKING, OF_CHANNELS and `_halves`."""

    preset: str = "default"
    labels: Sequence[str] | None = None
    dynamic: Sequence[str] | None = None
    numbers: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Query:
    """A query; `filters` by the names in `_filters`."""

    image: bytes
    top: int = 5
    candidates: int | None = None
    filters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """The answer to a query: evidence without ids, times and revisions; recipe and revision of this run."""

    evidence: Evidence
    recipe: str | None
    revision: int | None


def drawn_place(
    name: str,
    size: tuple[int, int] = (320, 240),
    light: Literal["noon", "overcast", "dusk", "night"] = "noon",
    things: Sequence[str] = (),
    **moved: float,
) -> Pixels:
    """A drawn place, uint8 (height, width, 3); `moved` by dx, ahead, up in metres and turn, tilt in degrees."""
    return scene(name).at(light).seen_from(**moved).behind(*things).sized(*size).pixels


class Service:
    """A whole service over a data folder, called through its HTTP interface."""

    def __init__(self, data: Path, encoder: EncoderName) -> None:
        self._runtime = build(Settings(data=data, encoder=encoder, threads=1, compare=False))
        self._client = TestClient(create_app(self._runtime), raise_server_exceptions=False)
        self._ids: dict[tuple[str, str], str] = {}

    def __enter__(self) -> Self:
        self._client.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.__exit__(kind, error, trace)

    # maps and views

    def make_map(self, name: str, options: MapOptions) -> Evidence:
        """Make a map; returns its facts, or the error."""
        return _refusal(self._client.put(f"/maps/{name}", json=_wanted(options))) or self.map_facts(name)

    def map_facts(self, name: str) -> Evidence:
        """The facts of a map that are equal in every run."""
        facts = self._client.get(f"/maps/{name}").json()
        return {
            "labels": [label["label"] for label in facts["labels"]],
            "dynamic": [label["label"] for label in facts["labels"] if label["dynamic"]],
            **{f"vocabulary_size.{c}": size for c, size in facts["vocabulary"]["vocabulary_size"].items()},
            **{f"dimensions.{c}": size for c, size in facts["vocabulary"]["dimensions"].items()},
        }

    def recipe_of(self, name: str) -> str:
        """Id of the recipe that a map uses."""
        return str(self._client.get(f"/maps/{name}").json()["recipe"]["id"])

    def enroll(self, map_name: str, view: View) -> Evidence:
        """Enrol an image and wait for its description; returns its facts, or the error."""
        said = {"map": map_name, "place": view.place, "captured_at": view.captured_at, **view.position}
        answer = self._client.post(
            "/enroll",
            files=[("image", (view.name, view.image, "application/octet-stream"))],
            data={name: str(value) for name, value in said.items() if value is not None}
            | {"metadata": json.dumps({**view.metadata, "name": view.name})},
        )
        if answer.status_code != 201:
            return _refusal(answer) or {"http_status": answer.status_code}
        enrolled = answer.json()["view"]
        self._ids[map_name, view.name] = enrolled["id"]
        described = enrolled["description"]
        return {
            "sampled_descriptors": described["sampled_descriptors"],
            "static_share": described["static_share"],
            "nodes": described["nodes"],
            **_labels("", described["labels"]),
        }

    def delete(self, map_name: str, view: str) -> None:
        """Delete a view."""
        self._client.delete(f"/views/{self._ids[map_name, view]}").raise_for_status()

    def change_recipe(self, name: str, options: MapOptions) -> None:
        """Describe a map's views by another recipe, and wait until the map uses it."""
        begun = self._client.post(f"/maps/{name}/recipe", json=_wanted(options))
        begun.raise_for_status()
        until = time.monotonic() + PATIENCE_S
        while (job := self._client.get(begun.headers["location"]).json())["state"] != "done":
            if job["state"] == "failed" or time.monotonic() > until:
                raise AssertionError(f"the map {name} did not change over: {job}")
            time.sleep(0.01)

    # queries

    def query(self, map_name: str, query: Query) -> Answer:
        """Query a map with an image; returns all evidence."""
        parameters = {"map": map_name, "top": query.top, "explain": "true"} | self._filters(map_name, query.filters)
        if query.candidates is not None:
            parameters["candidates"] = query.candidates
        answer = self._client.post(
            "/query", params=parameters, content=query.image, headers={"content-type": "application/octet-stream"}
        )
        refused = _refusal(answer)
        if refused:
            return Answer(refused, None, None)
        body = answer.json()
        return Answer(_evidence(body), body["recipe"], body["revision"])

    def _filters(self, map_name: str, filters: Mapping[str, Any]) -> dict[str, str]:
        """Filters as parameters of the URL: near and near_degrees (three numbers), place, after, before, exclude_last,
        exclude (names of views), metadata (a mapping)."""
        written = {name: str(filters[name]) for name in ("place", "after", "before", "exclude_last") if name in filters}
        if "near" in filters:
            written["near"] = ",".join(map(str, filters["near"]))
        if "near_degrees" in filters:
            written |= {"near": ",".join(map(str, filters["near_degrees"])), "frame": "geo"}
        if "exclude" in filters:
            written["exclude"] = ",".join(self._ids[map_name, name] for name in filters["exclude"])
        return written | {f"metadata.{key}": value for key, value in filters.get("metadata", {}).items()}

    # not through HTTP

    def describe(self, map_name: str, image: bytes) -> Evidence:
        """An image's description by a map's recipe: arrays, and numbers."""
        query = self._runtime.services.searcher
        found = query.describe(self._runtime.decode(image), query.describer(map_name)).value
        graph = found.appearance.graph
        arrays = {
            **{f"histogram.{name}": found.vectors[ours] for name, ours in CHANNELS.items() if ours in found.vectors},
            "dense_full": found.cells,
            "dense_half": found.appearance.coarse,
            "graph.labels": graph.labels,
            "graph.positions": graph.positions,
            "graph.embeddings": graph.embeddings,
            "graph.shares": graph.shares,
            "label_shares": found.label_shares,
            "extent": np.array(found.appearance.extent),
        }
        if found.keypoints is not None:
            arrays["local_features.positions"] = found.keypoints.positions
            arrays["local_features.descriptors"] = found.keypoints.descriptors
        return {**arrays, "static_share": found.static_share, "sampled_descriptors": found.descriptor_count}

    def forget_index(self, map_name: str) -> None:
        """Let the next query of a map read all its views; an enrolment queries its map, and leaves it up to date."""
        self._runtime.catalogue.forget(map_name)

    @contextmanager
    def interrupted(self, stage: str, action: Callable[[], None], times: int = 1) -> Iterator[list[str]]:
        """Run `action` inside the first `times` calls of a stage of STAGES, before the stage does its work.

        Yields
        ------
        list of str
            The stage's name, once for each call so far.
        """
        part, method = STAGES[stage]
        owner = attrgetter(part)(self._runtime)
        original = getattr(owner, method)
        calls: list[str] = []
        busy = False

        def wrapped(*given: Any, **named: Any) -> Any:
            nonlocal busy
            if not busy:  # calls by the action itself are not the query's
                calls.append(stage)
                if len(calls) <= times:
                    busy = True
                    try:
                        action()
                    finally:
                        busy = False
            return original(*given, **named)

        setattr(owner, method, wrapped)
        try:
            yield calls
        finally:
            delattr(owner, method)


def _wanted(options: MapOptions) -> dict[str, Any]:
    parameters, ranking = _halves(options.numbers)
    body: dict[str, Any] = {"preset": options.preset, "parameters": parameters, "ranking": ranking}
    if options.labels is not None:
        body["labels"] = list(options.labels)
    if options.dynamic is not None:
        body["dynamic"] = list(options.dynamic)
    return body


def _halves(numbers: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Neutral numbers as description parameters and ranking; `weights` are by term, those of OF_CHANNELS by channel."""
    parameters: dict[str, Any] = {}
    ranking: dict[str, Any] = {}

    def put(inner: dict[str, Any], path: Sequence[str], value: Any) -> None:
        for key in path[:-1]:
            inner = inner.setdefault(key, {})
        inner[path[-1]] = value

    for name, value in numbers.items():
        if name == "weights":
            for term, weight in value.items():
                put(ranking, ("weights", *term.split(".")), weight)
        elif name in RANKING:
            ranking[RANKING[name]] = value
        elif name in OF_CHANNELS:
            for channel, number in value.items():
                put(parameters, ("channels", channel, OF_CHANNELS[name]), number)
        else:
            put(parameters, DESCRIPTION[name], value)
    return parameters, ranking


def _refusal(answer: Any) -> Evidence | None:
    """Status and code of a problem; None for an answer without error."""
    if answer.status_code < 400:
        return None
    problem = answer.json()
    refused: Evidence = {"http_status": answer.status_code, "refused": problem["type"].rpartition(":")[2]}
    if problem.get("errors"):
        refused["parameters"] = len(problem["errors"])
    return refused


def _labels(prefix: str, shares: Sequence[Mapping[str, Any]]) -> Evidence:
    return {f"{prefix}labels": [s["label"] for s in shares], f"{prefix}label_shares": [s["share"] for s in shares]}


def _evidence(body: Mapping[str, Any]) -> Evidence:
    """An answer as a flat mapping; facts of matches are lists over the matches, best first."""
    names = {match["view"]["id"]: match["view"]["metadata"]["name"] for match in body["matches"]}
    found: Evidence = {
        "verdict": body["status"],
        "confidence": body["confidence"],
        "searched": body["searched"],
        "query.size": [body["query"]["width"], body["query"]["height"]],
        "query.static_share": body["query"]["static_share"],
        **_labels("query.", body["query"]["labels"]),
        "estimate": None,
    }
    if body["estimate"] is not None:
        position = body["estimate"]["position"]
        found["estimate"] = {axis: value for axis, value in position.items() if value is not None}
        found["estimate.radius_m"] = body["estimate"]["radius_m"]
        found["estimate.views"] = [names[view] for view in body["estimate"]["views"]]
    rows = [_match(match) for match in body["matches"]]
    columns = dict.fromkeys(key for row in rows for key in row)
    return found | {f"match.{key}": [row.get(key) for row in rows] for key in columns}


def _match(match: Mapping[str, Any]) -> Evidence:
    view, dense, graph, verified = match["view"], match["dense"], match["graph"], match["verification"]
    row: Evidence = {
        "view": view["metadata"]["name"],
        "rank": match["rank"],
        "score": match["score"],
        "confidence": match["confidence"],
        "sampled_descriptors": view["description"]["sampled_descriptors"],
    }
    row |= {f"parts.{term}": match["parts"][term] for term in TERMS if term in match["parts"]}
    for channel, ours in CHANNELS.items():
        if ours in match["channels"]:
            row[f"distance.{channel}"] = match["channels"][ours]["distance"]
            row[f"rank.{channel}"] = match["channels"][ours]["rank"]
    if dense is not None:
        row |= {f"dense.{name}": dense[ours] for name, ours in DENSE.items()}
        row |= {"dense.shift": dense["shift"], "dense.scale": dense["scale"]}
    if graph is not None:
        numbers = ("similarity", "correspondences", "nodes_query", "nodes_view", "edges_agreeing")
        row |= {f"graph.{name}": graph[name] for name in numbers}
        row["graph.pairs"] = [[p["label"], p["cosine"], *p["query"], *p["view"]] for p in graph["pairs"]]
    if verified is not None:
        row |= {f"verification.{name}": verified[name] for name in ("inliers", "matches", "transform")}
        row["verification.pairs"] = [[*ours, *theirs] for ours, theirs in verified["pairs"]]
    return row
