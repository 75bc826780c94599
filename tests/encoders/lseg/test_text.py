"""The text tower against an independent one; the tokenizer against a vocabulary of seven merges."""

import gzip
import importlib
import importlib.util
from pathlib import Path

import pytest
import torch

from schemas.errors import SetupError
from tests.encoders.lseg import naive, small
from worker.encoders.lseg import tokenizer as module
from worker.encoders.lseg.tokenizer import Tokenizer, TooLong, byte_order, byte_symbols, installed_vocabulary

START, END = small.SMALL.tokens - 2, small.SMALL.tokens - 1
MERGED = {"ar</w>": 512, "car</w>": 513, "sk": 514, "sky</w>": 515, "ro": 516, "roa": 517, "road</w>": 518}
TEXTS = [[START, 513, END], [START, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, END], [START, 515, 518, END]]


def test_the_tower_agrees_with_an_independent_one() -> None:
    weights = small.state()
    exact = {name: tensor.double() for name, tensor in weights.items()}

    vectors = small.network(weights).clip_pretrained(TEXTS)

    expected = torch.stack([naive.text_vector(ids, exact, small.SMALL) for ids in TEXTS])
    torch.testing.assert_close(vectors.double(), expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("slip", naive.TEXT_SLIPS)
def test_every_slip_would_be_seen(slip: str) -> None:
    weights = small.state()
    exact = {name: tensor.double() for name, tensor in weights.items()}

    vector = small.network(weights).clip_pretrained(TEXTS[:1])[0].double()

    assert (vector - naive.text_vector(TEXTS[0], exact, small.SMALL, slip)).abs().max() > 1e-4


def test_words_are_merged_in_the_order_of_the_vocabulary() -> None:
    encode = small.tokenizer().encode

    assert encode("car") == [START, MERGED["car</w>"], END]
    assert encode("Sky  ROAD\n") == [START, MERGED["sky</w>"], MERGED["road</w>"], END]
    # "ro" stops where "roads" has no further merge; bytes number from "!" = 0, with </w> 256 further.
    assert encode("roads") == [START, MERGED["roa"], ord("d") - 33, 256 + ord("s") - 33, END]
    # "ar" is a merge at a word's end only, and "sk" + "y" too.
    assert encode("skyar")[1] == MERGED["sk"]
    assert encode("skyar")[-2] == MERGED["ar</w>"]


def test_digits_and_signs_stand_alone() -> None:
    one, two = 256 + ord("1") - 33, 256 + ord("2") - 33

    assert small.tokenizer().encode("12") == [START, one, two, END]
    assert small.tokenizer().encode("car!?") == [START, 513, ord("!") - 33, 256 + ord("?") - 33, END]


def test_every_byte_has_a_symbol_of_its_own() -> None:
    assert sorted(byte_order()) == list(range(256))
    assert len(set(byte_symbols())) == 256
    # The first byte that Latin-1 does not print is 0, and takes U+0100; the space takes U+0120.
    symbols = dict(zip(byte_order(), byte_symbols(), strict=True))
    assert (symbols[ord("a")], symbols[0], symbols[ord(" ")]) == ("a", "\u0100", "\u0120")


def test_text_is_repaired_unescaped_collapsed_and_lowered() -> None:
    clean = small.tokenizer().clean

    assert clean("  Caf\u00c3\u00a9 \t \u201cBar\u201d ") == 'caf\u00e9 "bar"'
    assert clean("R&amp;amp;D &lt;road&gt;") == "r&d <road>"


def test_a_text_cannot_spell_the_end_mark() -> None:
    assert small.tokenizer().encode("<|end")[-1] == END
    assert small.tokenizer().encode("<|end").count(END) == 1


def test_a_text_that_does_not_fit_is_refused_not_cut() -> None:
    encode = small.tokenizer().encode

    assert len(encode("car " * 10)) == small.SMALL.context
    with pytest.raises(TooLong, match="13 tokens with start and end; 12 fit"):
        encode("car " * 11)


def test_another_vocabulary_is_refused_with_both_digests(tmp_path: Path) -> None:
    other = tmp_path / "merges.txt.gz"
    other.write_bytes(gzip.compress(f"#version\n{small.TOKENIZER_FILE_MERGES}\n".encode()))

    with pytest.raises(SetupError, match=r"expected 48894 merges with SHA-256 f61f2adf.*saw 8 with [0-9a-f]{64}"):
        Tokenizer.read(other, 77)


@pytest.mark.parametrize(
    "data", [b"\x1f\x8b\x08\x00broken", gzip.compress(b"a b\n" * 99, mtime=0)[:20], b"\xff\xfe\x00"]
)
def test_a_broken_vocabulary_is_refused(tmp_path: Path, data: bytes) -> None:
    broken = tmp_path / "merges.txt.gz"
    broken.write_bytes(data)

    with pytest.raises(SetupError, match="cannot be read as"):
        Tokenizer.read(broken, 77)
    with pytest.raises(SetupError, match="cannot be read as"):
        Tokenizer.read(tmp_path / "absent", 77)


def test_the_vocabulary_is_found_in_a_package_without_importing_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "open_clip"
    package.mkdir()
    (package / "__init__.py").write_text("raise RuntimeError('imported')")
    (package / module.FILE_NAME).write_bytes(b"")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(module, "PACKAGES", ("no_such_package", "open_clip"))
    importlib.invalidate_caches()

    assert installed_vocabulary() == package / module.FILE_NAME


def test_without_a_vocabulary_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PACKAGES", ("no_such_package",))

    with pytest.raises(SetupError, match=r"pip install ftfy openai-clip regex`.*REVISIT_BPE"):
        Tokenizer.read(None, 77)


def test_without_the_extra_its_packages_are_named() -> None:
    with pytest.raises(SetupError, match=r"needs the package no_such_package.*pip install ftfy openai-clip regex`"):
        module.extra("no_such_package")


@pytest.mark.skipif(importlib.util.find_spec("clip") is None, reason="the extra lseg is not installed")
def test_clips_own_vocabulary() -> None:
    """Ids as OpenAI's code gives them."""
    encode = Tokenizer.read(None, 77).encode

    assert encode("a photo of a cat") == [49406, 320, 1125, 539, 320, 2368, 49407]
    assert encode("") == [49406, 49407]
