"""An explanation shows what decided: cells, keypoints and regions that agree, and why a rival lost."""

import gc
import io
from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image as PilImage

from scenes import scene
from schemas.description import Int8s
from schemas.records import Filters, Position, ViewAttributes
from schemas.settings import Settings
from tests.stories.photos import photo
from worker.images.codec import shrink
from worker.images.explanation import WIDTH, Sheet
from worker.method.evidence import Ranking
from worker.runtime import Runtime, build
from worker.service.explanations import Explained, headline
from worker.service.query import QueryResult
from worker.service.query_options import QueryOptions
from worker.service.results import ScoredView
from worker.service.sheets import cells_of, name_of, sheet

pytestmark = pytest.mark.one_database("it is about what is drawn; tests/storage reads the same from both")

PLACES = ("mill lane", "station road", "rose garden", "market street")


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runtime]:
    built = build(Settings(data=tmp_path_factory.mktemp("data"), encoder="compact", threads=1))
    built.start()
    for name in PLACES:
        for turn in (0, 4):
            look = photo(scene(name).seen_from(turn=turn))
            built.services.enroll.enroll(look, "town", ViewAttributes(place=name), patience_s=60)
    yield built
    built.stop()


@pytest.fixture(scope="module")
def result(runtime: Runtime) -> QueryResult:
    taken = photo(scene("mill lane").seen_from(dx=0.3, turn=-2).behind("bus"))
    return runtime.services.query.query(taken, "town", options=QueryOptions(top=8))


def explained(result: QueryResult) -> Explained:
    return Explained.of(
        shrink(result.image), result.description, result.results, headline(result.decision), result.results.rival
    )


def cells(runtime: Runtime, *views: ScoredView) -> dict[int, Int8s]:
    recipe = runtime.services.searcher.describer("town").recipe
    return runtime.store.descriptions.cells([view.seq for view in views], recipe.id)


def drawn(runtime: Runtime, result: QueryResult, scored: ScoredView, other: ScoredView | None, **options: Any) -> Sheet:
    def image(view: ScoredView) -> Any:
        return runtime.decode(runtime.store.views.image(view.view.id)).pixels

    views = [scored] if other is None else [scored, other]
    return sheet(
        options.get("explained", explained(result)),
        scored,
        image(scored),
        None if other is None else (other, image(other)),
        options.get("stored", cells(runtime, *views)),
    )


def test_the_cells_are_those_that_made_the_score(runtime: Runtime, result: QueryResult) -> None:
    weights = result.results.recipe.ranking.weights.terms()
    exponent = result.results.recipe.ranking.scale_penalty
    compared = [view for view in result.results.views if view.dense is not None and view.dense.scale is not None]
    stored = cells(runtime, *compared)

    assert len(compared) == 8
    for view in compared:
        found = cells_of(explained(result), view, stored[view.seq])
        assert found is not None
        assert view.dense is not None
        assert view.dense.scale is not None
        penalty = min(view.dense.scale, 1 / view.dense.scale) ** exponent
        share = weights["dense_full"] / sum(weights.values())
        assert found.similarity * penalty * share == pytest.approx(view.parts["dense_full"], abs=1e-5)


def test_the_rival_is_the_best_of_another_place(result: QueryResult) -> None:
    views, rival = result.results.views, result.results.rival

    assert [view.view.attributes.place for view in views[:2]] == ["mill lane", "mill lane"]
    assert rival is not None
    assert rival.view.attributes.place != "mill lane"
    assert rival.score == max(view.score for view in views if view.view.attributes.place != "mill lane")


def test_a_sheet_says_what_agrees_and_why_the_rival_lost(runtime: Runtime, result: QueryResult) -> None:
    first, rival = result.results.views[0], result.results.rival
    assert rival is not None

    shown = drawn(runtime, result, first, rival)

    assert (shown.query.title, shown.match.title) == ("query", "enrolled: mill lane")
    assert shown.rival is not None
    assert shown.rival.title == f"enrolled: {rival.view.attributes.place}"
    assert (shown.headline.status, shown.headline.probability) == ("matched", result.decision.confidence)
    assert shown.headline.reason
    agreeing = cells_of(explained(result), first, cells(runtime, first)[first.seq])
    assert agreeing is not None
    assert shown.query.cells is not None
    np.testing.assert_array_equal(shown.query.cells, agreeing.of_query())
    assert shown.match.cells is not None
    np.testing.assert_array_equal(shown.match.cells, agreeing.of_candidate())
    assert any(note.startswith(f"{len(agreeing.weight)} of 448 cells agree") for note in shown.notes)
    assert [part.match for part in shown.parts] == [*first.parts.values(), first.score]
    assert [part.rival for part in shown.parts] == [*rival.parts.values(), rival.score]
    assert f"lost by {first.score - rival.score:.3f}: cells agree less" in shown.verdict
    assert first.verified is not None
    assert len(shown.inliers) == first.verified.inliers > 0
    assert shown.speaks is not None
    assert {1} <= set(np.unique(shown.speaks)) <= {-1, 0, 1}


def test_a_query_by_another_camera_is_shown_as_it_was_compared(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, sheets = photo(scene("mill lane").seen_from(dx=0.3)), list[Sheet]()

    def kept(sheet: Sheet) -> bytes:
        sheets.append(sheet)
        return b""

    monkeypatch.setattr("worker.service.renderings.explanation_png", kept)
    for zoom in (1.0, 0.8):
        answer = runtime.services.query.query(taken, "town", options=QueryOptions(zoom=zoom, explain=True))
        runtime.services.renderings.explanation(answer.id, None)
    shown = [(each.query.title, each.query.pixels.shape[1]) for each in sheets]
    assert shown == [("query", 640), ("query, as the map's camera would see it", 512)]


def test_a_lower_match_is_compared_with_the_first(runtime: Runtime, result: QueryResult) -> None:
    of = explained(result)
    third, first = result.results.views[2], result.results.views[0]

    assert of.compared_with(third) is first
    assert of.compared_with(first) is of.rival
    shown = drawn(runtime, result, third, first)
    assert shown.match.caption.startswith("rank 3 · ")
    assert shown.rival is not None
    assert shown.rival.caption.startswith("first match · ")
    assert f"mill lane won by {first.score - third.score:.3f}: cells agree more" in shown.verdict


def test_cells_that_are_not_kept_any_more_are_said_to_be_missing(runtime: Runtime, result: QueryResult) -> None:
    first, rival = result.results.views[0], result.results.rival
    assert rival is not None

    neither = drawn(runtime, result, first, rival, stored={})
    ours = drawn(runtime, result, first, rival, stored=cells(runtime, first))
    both = drawn(runtime, result, first, rival)

    assert (neither.query.cells, neither.match.cells, neither.speaks) == (None, None, None)
    assert ours.match.cells is not None
    assert ours.speaks is None
    missing = [[note for note in one.notes if "described anew" in note] for one in (neither, ours, both)]
    assert [len(notes) for notes in missing] == [2, 1, 0]
    assert f"cells of {rival.view.attributes.place} " in missing[1][0]


def test_regions_of_things_that_move_and_specks_are_not_shown_as_evidence(
    runtime: Runtime, result: QueryResult
) -> None:
    first = result.results.views[0]
    assert first.graph is not None
    recipe, graph = result.results.recipe, result.description.appearance.graph
    large = [
        recipe.description.labels[graph.labels[p]]
        for p, r in first.graph.pairs
        if graph.shares[p] >= 0.01 and first.graph.view.shares[r] >= 0.01
    ]
    assert len(set(large)) > 1

    moving = recipe.model_copy(update={"description": recipe.description.model_copy(update={"dynamic": (large[0],)})})
    of = explained(result)
    plain = drawn(runtime, result, first, None)
    filtered = drawn(runtime, result, first, None, explained=replace(of, recipe=moving))

    assert [label for label, *_ in plain.nodes] == large
    assert [label for label, *_ in filtered.nodes] == [label for label in large if label != large[0]]
    assert any("drawn: the others are small or of things that move" in note for note in filtered.notes)


def test_a_long_name_does_not_fill_the_sentence(runtime: Runtime, result: QueryResult) -> None:
    first, second = result.results.views[:2]
    long = replace(second.view, attributes=ViewAttributes(place="wing " * 39 + "0042"))

    shown = drawn(runtime, result, first, replace(second, view=long))

    assert shown.verdict.startswith("wing wing ")
    assert "wing 0042 lost by" in shown.verdict
    assert len(shown.verdict.partition(" lost by")[0]) <= 49
    assert shown.rival is not None
    assert shown.rival.title == f"enrolled: {long.attributes.place}"


def test_keypoints_that_do_not_count_are_said_not_to(runtime: Runtime, result: QueryResult) -> None:
    first = result.results.views[0]
    assert first.parts["verification"] > 0
    gated = replace(first, parts={**first.parts, "verification": 0.0})

    told = [" ".join(drawn(runtime, result, one, None).notes) for one in (first, gated)]

    assert ["keypoints fit one geometry; too few" in notes for notes in told] == [False, True]


def test_a_view_is_named_by_its_place_its_file_or_its_id(result: QueryResult) -> None:
    view = result.results.views[0].view
    assert name_of(view) == "mill lane"
    assert name_of(replace(view, attributes=ViewAttributes(metadata={"file": "0042.jpg"}))) == "0042.jpg"
    assert name_of(replace(view, attributes=ViewAttributes(metadata={"file": 42}))) == view.id
    assert name_of(replace(view, attributes=ViewAttributes(None, Position()))) == view.id


def test_the_rival_is_shown_whatever_top_is_and_may_be_deleted(runtime: Runtime) -> None:
    for name in PLACES[:2]:
        attributes = ViewAttributes(place=name)
        runtime.services.enroll.enroll(photo(scene(name)), "again", attributes, patience_s=60)
    taken = photo(scene("mill lane").seen_from(turn=2))
    kept = runtime.services.query.query(taken, "again", options=QueryOptions(top=1, explain=True))
    assert [view.view.attributes.place for view in kept.results.views[: kept.top]] == ["mill lane"]
    draw = runtime.services.renderings.explanation

    with_rival = PilImage.open(io.BytesIO(draw(kept.id, None)))
    other = next(v for v in runtime.store.views.list("again", Filters())[0] if v.attributes.place == "station road")
    runtime.services.views.delete(other.id)
    without = PilImage.open(io.BytesIO(draw(kept.id, None)))

    assert with_rival.width == without.width == WIDTH
    assert with_rival.size != without.size


def called(runtime: Runtime, view_id: str, place: str | None) -> None:
    runtime.services.views.change(view_id, lambda has: replace(has, place=place))


def test_views_are_called_what_they_are_called_now(runtime: Runtime) -> None:
    """Who takes the name of a place back does not want to read it in a drawing."""
    services = runtime.services
    for name in PLACES[2:]:
        services.enroll.enroll(photo(scene(name)), "renamed", ViewAttributes(place=name), patience_s=60)
    taken = photo(scene("rose garden").seen_from(turn=2))
    kept = services.query.query(taken, "renamed", options=QueryOptions(explain=True))
    for at in (0, 1):  # the match and its rival
        before = services.renderings.explanation(kept.id, None)
        view = kept.results.views[at].view
        called(runtime, view.id, "elsewhere")
        assert services.renderings.explanation(kept.id, None) != before
        called(runtime, view.id, view.attributes.place)
        assert services.renderings.explanation(kept.id, None) == before


def test_what_is_kept_of_a_query_holds_no_evidence_of_all_its_candidates(result: QueryResult) -> None:
    """It is as much memory as the image, and the latest 200 explained queries are kept."""
    seen: set[int] = set()
    reached: list[object] = [explained(result)]
    while reached:
        one = reached.pop()
        if id(one) in seen or isinstance(one, type | ModuleType):
            continue
        seen.add(id(one))
        assert not isinstance(one, Ranking)
        reached += gc.get_referents(one)
    assert id(result.results.views[0]) in seen
