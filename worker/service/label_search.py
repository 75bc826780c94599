"""Words for labels, as people write them in a search."""

from collections.abc import Sequence

from schemas.errors import InvalidParameters
from worker.method.label_terms import Terms

MOST = 32
"""Words of one search."""


def terms_of(text: str, labels: Sequence[str], map_name: str) -> Terms:
    """Parse ``fence,pole+sign``: terms with commas between, labels that stand together with + between.

    A + in a URL arrives as a space, unless it was written %2B: a term that is no label is therefore also taken apart at
    its spaces, longest labels first.

    Raises
    ------
    InvalidParameters
        A word is no label of the map; the text names those that are.
    """
    index = {label.casefold(): number for number, label in reversed(list(enumerate(labels)))}
    terms, unknown = [], []
    for term in text.split(","):
        found: list[int] = []
        for piece in term.split("+"):
            numbers = _apart(piece.casefold().split(), index)
            if numbers is None:
                unknown.append(piece.strip())
            else:
                found += numbers
        if len(set(found)) < len(found):
            raise InvalidParameters.of("words", f"{term.strip()!r} names a label twice")
        terms.append(tuple(found))
    if unknown:
        named = ", ".join(repr(word[:60]) for word in unknown[:MOST])
        raise InvalidParameters.of(
            "words", f"{named}: no label of the map {map_name!r}, whose labels are {', '.join(labels)}"
        )
    if sum(map(len, terms)) > MOST:
        raise InvalidParameters.of("words", f"has more than {MOST} words")
    return tuple(terms)


def _apart(parts: Sequence[str], index: dict[str, int]) -> list[int] | None:
    """Numbers of the labels that words joined by spaces are; None when they are not."""
    if not parts:
        return None
    found = []
    start = 0
    while start < len(parts):
        for end in range(len(parts), start, -1):
            number = index.get(" ".join(parts[start:end]))
            if number is not None:
                found.append(number)
                start = end
                break
        else:
            return None
    return found
