import numpy as np
import pytest

from schemas.errors import InvalidParameters
from worker.method.label_terms import presence
from worker.service.label_search import terms_of

LABELS = ("fence", "tree", "traffic light", "pole", "light pole")


def test_shares_add_up_and_together_both_are_needed() -> None:
    shares = np.array([[0.5, 0.2, 0, 0.1, 0], [0.3, 0.3, 0, 0, 0], [0.6, 0, 0, 0, 0], [0, 0, 0, 0.9, 0]], np.float32)

    assert presence(shares, ((0,), (1,))).tolist() == pytest.approx([0.7, 0.6, 0.6, 0], abs=1e-6)
    assert presence(shares, ((0, 1),)).tolist() == pytest.approx([2 * 0.1**0.5, 0.6, 0, 0], abs=1e-6)
    assert presence(shares[:0], ((0,),)).tolist() == []


@pytest.mark.parametrize(
    ("text", "terms"),
    [
        ("fence", ((0,),)),
        ("Fence , TREE", ((0,), (1,))),
        ("pole+fence", ((3, 0),)),
        ("pole fence", ((3, 0),)),  # as + in a URL arrives
        ("traffic light pole", ((2, 3),)),
        ("light pole tree,fence", ((4, 1), (0,))),
    ],
)
def test_words_are_read_as_people_write_them(text: str, terms: object) -> None:
    assert terms_of(text, LABELS, "campus") == terms


@pytest.mark.parametrize("text", ["fnce", "fence,", "fence+", "light", "tree,,fence", ",".join(["tree"] * 33)])
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(InvalidParameters):
        terms_of(text, LABELS, "campus")


def test_the_known_labels_are_named() -> None:
    with pytest.raises(InvalidParameters, match=r"'fnce', 'moon': .*campus.* fence, tree, traffic light, pole, light"):
        terms_of("fnce,moon,tree", LABELS, "campus")
    with pytest.raises(InvalidParameters, match="twice"):
        terms_of("tree+tree", LABELS, "campus")
