"""Calls about maps: their recipes, settings and calibrations, and their places."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import address, listed, recipe_fields, texts


class MapCalls:
    """The calls of a client about maps and their places."""

    _connection: Connection

    def maps(self) -> list[wire.MapFacts]:
        """All maps, by name."""
        return self._connection.receive(wire.Maps, "GET", "/maps").maps

    def map(self, name: str) -> wire.MapFacts:
        """One map."""
        return self._connection.receive(wire.MapFacts, "GET", address("maps", name))

    def put_map(
        self,
        name: str,
        *,
        labels: Sequence[str] | None = None,
        dynamic: Sequence[str] | None = None,
        preset: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        ranking: Mapping[str, Any] | None = None,
    ) -> wire.MapFacts:
        """Make a map, or give an empty one other labels, preset, parameters or ranking."""
        recipe = recipe_fields(labels, dynamic, preset, parameters, ranking)
        return self._connection.receive(wire.MapFacts, "PUT", address("maps", name), json=recipe)

    def switch_recipe(
        self,
        name: str,
        *,
        labels: Sequence[str] | None = None,
        dynamic: Sequence[str] | None = None,
        preset: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        ranking: Mapping[str, Any] | None = None,
        shadow: int | None = None,
    ) -> wire.Job:
        """Describe all views of a map by another recipe; until that is done, queries use the old one.

        What is None stays. A `preset` that is named, the map's own too, brings its parameters and ranking as the
        service has them now. With `shadow` the map does not change over: so many of its last queries are answered by
        both recipes. See `shadow`, `switch_to_shadow` and `discard_shadow`.
        """
        recipe = recipe_fields(labels, dynamic, preset, parameters, ranking)
        if shadow is not None:
            recipe["shadow"] = shadow
        return self._connection.receive(wire.Job, "POST", address("maps", name, "recipe"), json=recipe, repeat=False)

    def preview_dynamic(self, name: str, dynamic: Sequence[str], *, limit: int | None = None) -> wire.DynamicPreview:
        """What `switch_recipe` with these dynamic labels would leave out of a map's views; shares are upper bounds."""
        given = texts({"dynamic": listed(dynamic), "limit": limit})
        return self._connection.receive(wire.DynamicPreview, "GET", address("maps", name, "dynamic"), params=given)

    def change_ranking(self, name: str, **ranking: Any) -> wire.MapFacts:
        """Change fields of a map's ranking config, from the next query on; the others stay."""
        return self.change_map(name, ranking=ranking)

    def change_map(
        self,
        name: str,
        *,
        ranking: Mapping[str, Any] | None = None,
        blur: Sequence[str] | None = None,
        keep_images: bool | None = None,
        keep_queries: int | None = None,
        keep_matches: int | None = None,
        refuse_poor: bool | None = None,
    ) -> wire.MapFacts:
        """Change settings of a map together: all that are given, or, when one of them is refused, none.

        Parameters
        ----------
        name : str
        ranking : mapping or None
            Fields of the ranking config to change, from the next query on; the others stay.
        blur : sequence of str or None
            What is covered in each image before it is stored: `people`, `vehicles`, labels; empty: nothing.
        keep_images : bool or None
            False removes all images, for good, and each later one once its view is described.
        keep_queries, keep_matches : int or None
            How many queries are kept at most that matched nothing, or a view that they look unlike; 0: none.
        refuse_poor : bool or None
            Refuse to enrol images that are dark, overexposed, covered or blurred, show mostly what moves, or are nearly
            in the map already.
        """
        given = {
            "ranking": None if ranking is None else dict(ranking),
            "blur": None if blur is None else list(blur),
            "keep_images": keep_images,
            "keep_queries": keep_queries,
            "keep_matches": keep_matches,
            "refuse_poor": refuse_poor,
        }
        changes = {field: value for field, value in given.items() if value is not None}
        return self._connection.receive(wire.MapFacts, "PATCH", address("maps", name), json=changes)

    def keep_images(self, name: str, wanted: bool) -> wire.MapFacts:
        """Keep a map's images, or remove them for good: all now, and each later one once its view is described."""
        return self.change_map(name, keep_images=wanted)

    def blur(self, name: str, *words: str) -> wire.MapFacts:
        """Cover `people`, `vehicles` or labels in each image of a map before it is stored; no words: nothing."""
        return self.change_map(name, blur=words)

    def refuse_poor(self, name: str, wanted: bool = True) -> wire.MapFacts:
        """Refuse to enrol images that are dark, overexposed, covered or blurred, show mostly what moves, or are nearly
        in the map already; or no longer."""
        return self.change_map(name, refuse_poor=wanted)

    def keep_queries(self, name: str, count: int) -> wire.MapFacts:
        """Keep at most `count` queries of a map that matched nothing; 0 deletes those that are kept."""
        return self.change_map(name, keep_queries=count)

    def keep_matches(self, name: str, count: int) -> wire.MapFacts:
        """Keep at most `count` queries of a map that matched a view although they look unlike it; 0 deletes them."""
        return self.change_map(name, keep_matches=count)

    def train_vocabulary(self, name: str) -> wire.Job:
        """Train a vocabulary on the map's own views, then describe them by it."""
        return self._connection.receive(wire.Job, "POST", address("maps", name, "vocabulary"), repeat=False)

    def calibrate(
        self,
        name: str,
        *,
        observed: Sequence[Mapping[str, Any]] = (),
        queries: Sequence[Mapping[str, Any]] = (),
        **options: Any,
    ) -> wire.CalibrationReport:
        """Fit a map's confidences to labelled queries: answers ``{"features": answer.decision.features, "right": ...}``
        or views ``{"view": id, "place": ...}``; options as in the body of the call, such as ``dry_run=True``."""
        labels = {"observed": [*map(dict, observed)], "queries": [*map(dict, queries)], **options}
        return self._connection.receive(
            wire.CalibrationReport, "POST", address("maps", name, "calibration"), json=labels
        )

    def forget_calibration(self, name: str) -> wire.MapFacts:
        """Return a map to the shipped calibration."""
        return self._connection.receive(wire.MapFacts, "DELETE", address("maps", name, "calibration"))

    def delete_map(self, name: str) -> wire.Deleted:
        """Delete a map, its views and their images."""
        return self._connection.receive(wire.Deleted, "DELETE", address("maps", name))

    def places(self, map: str | None = None) -> Iterator[wire.Place]:
        """Iterate over all places, fetched in pages as needed."""
        for page in self._connection.pages(wire.Places, "/places", texts({"map": map})):
            yield from page.places
