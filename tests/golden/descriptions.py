"""Images whose descriptions are golden, each with the map whose recipe describes it."""

from collections.abc import Mapping

DESCRIBED: Mapping[str, tuple[str, str]] = {
    "a street": ("town", "lane"),
    "a street at night with a phone held upright": ("town", "station, held upright"),
    "a park": ("town", "park, dull"),
    "a bus in front": ("town", "lane, behind a bus"),
    "a blank wall": ("town", "wall"),
    "as the paper does": ("paper", "lane"),
    "assigned to one word": ("hard assignment", "lane"),
    "a street in colours": ("few, in colours", "lane"),
    "colours": ("colours", "blobs 1, cut"),
}
