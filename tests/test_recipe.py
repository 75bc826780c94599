"""The two halves of a recipe: what is refused, what their ids depend on, and where a misplaced parameter is sent."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from schemas.description import DETAIL, SEMANTIC
from schemas.errors import InvalidParameters, ParameterError
from schemas.recipe import (
    CAME_LATER,
    CellGrid,
    Channel,
    DescriptionParameters,
    DescriptionRecipe,
    MapRecipe,
    RankingConfig,
    TermWeights,
)
from worker.description.presets import PRESETS, Wanted, changed_ranking, make_recipe
from worker.encoders.color import ColorEncoder

RECIPE = DescriptionRecipe(
    encoder="compact",
    weights="5" * 64,
    labels=("road", "sky", "car"),
    dynamic=("car",),
    parameters=PRESETS["default"].parameters,
    vocabulary="7" * 64,
)
RANKING = PRESETS["default"].ranking
TERMS = ("dense_full", "dense", "graph", "verification")
JSON = Mapping[str, Any]


class TestTermWeights:
    @pytest.mark.parametrize("term", TERMS)
    @pytest.mark.parametrize("weight", [-0.001, -1.0, 1001.0, float("nan"), float("inf"), None, "much"])
    def test_a_weight_is_a_number_from_0_to_1000(self, term: str, weight: object) -> None:
        with pytest.raises(ValidationError) as refusal:
            TermWeights.model_validate({"dense": 1.0, term: weight})
        assert [error["loc"] for error in refusal.value.errors()] == [(term,)]

    @pytest.mark.parametrize("weight", [-0.001, 1001.0, float("nan")])
    def test_so_is_that_of_a_channels_histogram(self, weight: float) -> None:
        with pytest.raises(ValidationError) as refusal:
            TermWeights.model_validate({"dense": 1.0, "histogram": {SEMANTIC: weight}})
        assert [error["loc"] for error in refusal.value.errors()] == [("histogram", SEMANTIC)]

    @pytest.mark.parametrize("weights", [{}, dict.fromkeys(TERMS, 0), {"histogram": {SEMANTIC: 0, DETAIL: 0.0}}])
    def test_some_term_counts(self, weights: JSON) -> None:
        with pytest.raises(ValidationError, match="every weight is 0, so that all views would score the same"):
            TermWeights.model_validate(weights)

    @pytest.mark.parametrize("weights", [{"dens": 5}, {"dense": 1, "close": 1}, {"histogram.semantic": 1.0}])
    def test_a_term_that_does_not_exist_is_refused(self, weights: JSON) -> None:
        with pytest.raises(ValidationError) as refusal:
            TermWeights.model_validate(weights)
        assert "extra_forbidden" in [error["type"] for error in refusal.value.errors()]

    @given(st.lists(st.floats(0, 1000), min_size=6, max_size=6).filter(any))
    def test_its_terms_have_the_names_that_answers_use(self, values: list[float]) -> None:
        full, half, semantic, detail, graph, verification = values

        weights = TermWeights(
            dense_full=full,
            dense=half,
            histogram={SEMANTIC: semantic, DETAIL: detail},
            graph=graph,
            verification=verification,
        )

        names = ("dense_full", "dense", "histogram.semantic", "histogram.detail", "graph", "verification")
        assert weights.terms() == dict(zip(names, values, strict=True))


class TestFields:
    @pytest.mark.parametrize(
        ("model", "content"),
        [
            (DescriptionRecipe, RECIPE.model_dump(mode="json")),
            (DescriptionParameters, RECIPE.parameters.model_dump(mode="json")),
            (RankingConfig, RANKING.model_dump(mode="json")),
            (Channel, {"layer": SEMANTIC, "vocabulary_size": 8}),
            (CellGrid, {}),
        ],
        ids=lambda value: value.__name__ if isinstance(value, type) else "",
    )
    def test_one_that_is_unknown_is_refused(self, model: type[RankingConfig], content: JSON) -> None:
        with pytest.raises(ValidationError) as refusal:
            model.model_validate({**content, "drive": 1})
        assert [(error["loc"], error["type"]) for error in refusal.value.errors()] == [(("drive",), "extra_forbidden")]

    @pytest.mark.parametrize(
        "changes",
        [
            {"candidates": -1},
            {"candidates": 501},
            {"full_resolution_top_k": -1},
            {"detail_only_top_k": 101},
            {"verified_top_k": -1},
            {"scale_penalty": -0.1},
            {"scale_penalty": float("nan")},
            {"graph_cosine": 1.0},
            {"graph_max_edge": 0},
            {"mode": "paper"},
        ],
        ids=str,
    )
    def test_one_of_the_ranking_out_of_its_range_is_refused_by_its_name(self, changes: JSON) -> None:
        with pytest.raises(ValidationError) as refusal:
            RankingConfig.model_validate(changes)
        assert [error["loc"] for error in refusal.value.errors()] == [tuple(changes)]

    def test_cells_join_channels_that_there_are(self) -> None:
        channels = {SEMANTIC: Channel(layer=SEMANTIC, vocabulary_size=8)}

        with pytest.raises(ValidationError, match="detail are not among the channels semantic"):
            DescriptionParameters(channels=channels, dense=CellGrid(channel_weights={DETAIL: 1.0}))

    def test_no_value_can_be_changed(self) -> None:
        with pytest.raises(ValidationError, match="frozen"):
            RANKING.candidates = 7  # type: ignore[misc]


def reordered(value: Any) -> Any:
    """The same JSON with the keys of every object the other way round."""
    if isinstance(value, dict):
        return {key: reordered(inner) for key, inner in reversed(value.items())}
    return [reordered(inner) for inner in value] if isinstance(value, list) else value


def paths(value: JSON, way: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Where the values of a JSON object are that are no objects themselves."""
    found = []
    for key, inner in value.items():
        here = (*way, key)
        found += paths(inner, here) if isinstance(inner, dict) and inner else [here]
    return found


def different(model: type[DescriptionRecipe] | type[RankingConfig], content: JSON, way: tuple[str, ...]) -> Any:
    """The value with another one, which is allowed there, at one place."""
    for other in (0.5, 0.25, 3, 9, 480, True, False, "other", "graph", "l1", ["sky", "road"], ["sky"], None):
        copy = json.loads(json.dumps(content))
        inner = copy
        for key in way[:-1]:
            inner = inner[key]
        if inner[way[-1]] == other:
            continue
        inner[way[-1]] = other
        try:
            return model.model_validate(copy)
        except ValidationError:
            continue
    raise AssertionError(f"nothing else is allowed at {way}")


class TestId:
    @pytest.mark.parametrize("half", [RECIPE, RANKING], ids=["description", "ranking"])
    def test_the_order_of_keys_does_not_change_it(self, half: DescriptionRecipe | RankingConfig) -> None:
        content = half.model_dump(mode="json")

        assert list(reordered(content)) == list(reversed(content))
        assert type(half).model_validate(reordered(content)).id == half.id
        assert type(half).model_validate_json(half.model_dump_json()).id == half.id

    @pytest.mark.parametrize("way", paths(RECIPE.model_dump(mode="json")), ids=".".join)
    def test_any_field_of_a_description_changes_it(self, way: tuple[str, ...]) -> None:
        assert different(DescriptionRecipe, RECIPE.model_dump(mode="json"), way).id != RECIPE.id

    @pytest.mark.parametrize("way", paths(RANKING.model_dump(mode="json")), ids=".".join)
    def test_any_field_of_a_ranking_changes_it(self, way: tuple[str, ...]) -> None:
        assert different(RankingConfig, RANKING.model_dump(mode="json"), way).id != RANKING.id

    def test_what_is_left_out_is_the_default_and_no_other_recipe(self) -> None:
        written = {"layer": SEMANTIC, "vocabulary_size": 8}
        short, long = (
            DescriptionParameters.model_validate({"channels": {SEMANTIC: channel}})
            for channel in (written, {**written, "assignments": 1, "temperature": 0.05})
        )

        ids = {RECIPE.model_copy(update={"parameters": parameters}).id for parameters in (short, long)}
        assert len(ids) == 1

    def test_recipes_stored_before_a_parameter_came_keep_theirs(self) -> None:
        content = RECIPE.model_dump(mode="json")
        for name in CAME_LATER:
            del content["parameters"][name]

        before = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        assert DescriptionRecipe.model_validate(content).id == hashlib.sha256(before.encode()).hexdigest()[:16]

    def test_it_is_sixteen_hexadecimal_digits(self) -> None:
        for half in (RECIPE, RANKING):
            assert len(half.id) == 16
            assert int(half.id, 16) >= 0

    def test_how_a_map_ranks_does_not_change_what_its_descriptions_are_called(self) -> None:
        plain, other = (
            make_recipe(ColorEncoder(), Wanted(ranking=ranking), preset="default")
            for ranking in (None, {"candidates": 7, "weights": {"graph": 3.0}, "graph_cosine": 0.5})
        )

        assert plain.description.id == other.description.id
        assert plain.ranking.id != other.ranking.id


def refused(wanted: Wanted) -> list[ParameterError]:
    with pytest.raises(InvalidParameters) as refusal:
        make_recipe(ColorEncoder(), wanted, preset="default")
    return list(refusal.value.errors)


OF_RANKINGS = set(RankingConfig.model_fields) - {"preset"}
OF_DESCRIPTIONS = set(DescriptionParameters.model_fields)


class TestRefusals:
    @pytest.mark.parametrize("name", sorted(OF_RANKINGS))
    def test_a_ranking_parameter_among_the_parameters_is_sent_to_the_ranking(self, name: str) -> None:
        assert refused(Wanted(parameters={name: 7})) == [
            ParameterError(f"parameters.{name}", "belongs to `ranking`, not to `parameters`")
        ]

    @pytest.mark.parametrize("name", sorted(OF_DESCRIPTIONS))
    def test_a_description_parameter_in_the_ranking_is_sent_to_the_parameters(self, name: str) -> None:
        assert refused(Wanted(ranking={name: 7})) == [
            ParameterError(f"ranking.{name}", "belongs to `parameters`, not to `ranking`")
        ]

    @pytest.mark.parametrize("value", [True, "5", 5.5])
    def test_what_is_no_whole_number_is_not_taken_for_one(self, value: object) -> None:
        [parameters] = refused(Wanted(parameters={"local_features": value}))
        [ranking] = refused(Wanted(ranking={"candidates": value}))
        for one in (parameters, ranking):
            assert one.detail == f"Input should be a valid integer (got {value!r})"

    def test_a_name_that_neither_knows_comes_with_those_that_are_known(self) -> None:
        [parameters] = refused(Wanted(parameters={"kandidates": 7}))
        [ranking] = refused(Wanted(ranking={"kandidates": 7}))

        assert parameters.detail == f"is unknown; known are {', '.join(DescriptionParameters.model_fields)}"
        assert ranking.detail == f"is unknown; known are {', '.join(RankingConfig.model_fields)}"

    def test_all_that_is_wrong_is_said_at_once(self) -> None:
        wanted = Wanted(
            labels=["road", "road"],
            dynamic=["bus"],
            parameters={"candidates": 5, "local_features": 1},
            ranking={"weights": {"dens": 5, "graph": -1}, "verified_top_k": 1000},
        )

        assert [error.parameter for error in refused(wanted)] == [
            "labels",
            "dynamic",
            "parameters.local_features",
            "parameters.candidates",
            "ranking.weights.graph",
            "ranking.weights.dens",
            "ranking.verified_top_k",
        ]

    def test_weights_of_zero_are_refused_where_they_are_changed(self) -> None:
        present = make_recipe(ColorEncoder(), Wanted(), preset="default")
        zeros = {**dict.fromkeys(TERMS, 0), "histogram": {SEMANTIC: 0, DETAIL: 0}}

        with pytest.raises(InvalidParameters, match="every weight is 0") as refusal:
            changed_ranking(present, {"weights": zeros})
        assert [error.parameter for error in refusal.value.errors] == ["ranking.weights"]

    def test_a_weight_of_a_channel_that_the_map_does_not_have_is_refused(self) -> None:
        [error] = refused(Wanted(ranking={"weights": {"histogram": {"colour": 1.0}}}))

        assert error == ParameterError(
            "ranking.weights.histogram", "colour are not among the channels semantic, detail"
        )

    def test_a_preset_is_not_named_within_the_ranking(self) -> None:
        [error] = refused(Wanted(ranking={"preset": "paper"}))

        assert error == ParameterError("ranking.preset", "is set by `preset`, beside `ranking`")

    def test_changes_are_merged_key_by_key(self) -> None:
        present = MapRecipe(description=RECIPE, ranking=RANKING)

        ranking = changed_ranking(present, {"weights": {"histogram": {DETAIL: 0.5}}, "candidates": 7})

        assert ranking.weights.histogram == {SEMANTIC: 0.04, DETAIL: 0.5}
        assert ranking.model_copy(update={"candidates": 50, "weights": RANKING.weights}) == RANKING
