"""CLIP's byte-pair encoder: text to token ids.

Text is repaired by ftfy (mojibake, curly quotes), HTML entities are resolved twice, white space is collapsed and the
rest is put in lower case, in this order, as CLIP does. What is left is cut into words, and each word's UTF-8 bytes are
merged pair by pair (Sennrich et al., ACL 2016) in the order of the vocabulary file.
"""

import functools
import gzip
import hashlib
import html
import importlib
import importlib.util
import itertools
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from schemas.errors import SetupError

FILE_NAME = "bpe_simple_vocab_16e6.txt.gz"
PACKAGES = ("clip", "open_clip")
"""Import names of packages that carry the file: openai-clip and clip-anytorch; open_clip_torch."""

INSTALL = "`.venv/bin/pip install ftfy openai-clip regex` (the extra `lseg`)"

MERGES = 48_894
"""Merges that CLIP uses of the 262,145 lines in its file: as many as make 49,408 tokens with bytes and marks."""

MERGES_SHA256 = "f61f2adf497e6f5357c347aeb4646fabe82f341e946de5bdec5d2858e41bef4a"
"""Of CLIP's merges, one pair a line without a newline behind the last."""

WORD_END = "</w>"

WORDS = r"'s|'t|'re|'ve|'m|'ll|'d|\p{L}+|\p{N}|[^\s\p{L}\p{N}]+"
"""English endings, runs of letters, single digits, runs of anything else. CLIP also lets a text spell its start and
end marks; here they are characters like others, so that no word can end its own sequence."""


class TooLong(ValueError):
    """A text has more tokens than fit the tower's positions."""


def byte_symbols() -> list[str]:
    """A printable character for each byte, in the order in which CLIP numbers them.

    Bytes that Latin-1 prints stand for themselves and come first; the others take characters from U+0100 on. The
    result is indexed by position in the numbering, and `byte_order` tells which byte is there.
    """
    return [chr(b) if b in _PRINTABLE else chr(256 + i - len(_PRINTABLE)) for i, b in enumerate(byte_order())]


_PRINTABLE = frozenset((*range(0x21, 0x7F), *range(0xA1, 0xAD), *range(0xAE, 0x100)))


def byte_order() -> list[int]:
    """The bytes in the order in which CLIP numbers them."""
    return sorted(range(256), key=lambda b: (b not in _PRINTABLE, b))


class Tokenizer:
    """Texts to token ids.

    Parameters
    ----------
    merges : sequence of (str, str)
        Pairs of symbols, the first to be merged first.
    context : int
        Longest sequence, start and end tokens included.
    """

    def __init__(self, merges: Sequence[tuple[str, str]], context: int) -> None:
        symbols = byte_symbols()
        tokens = [*symbols, *(s + WORD_END for s in symbols), *(a + b for a, b in merges)]
        self._id = {token: index for index, token in enumerate(tokens)}
        self._rank = {pair: rank for rank, pair in enumerate(merges)}
        self._symbol = dict(zip(byte_order(), symbols, strict=True))
        self._words = extra("regex").compile(WORDS, extra("regex").IGNORECASE)
        self._repair: Callable[[str], str] = extra("ftfy").fix_text
        self.start, self.end = len(tokens), len(tokens) + 1
        self.context = context

    @classmethod
    def read(cls, path: Path | None, context: int) -> "Tokenizer":
        """CLIP's tokenizer, from its vocabulary file.

        Parameters
        ----------
        path : Path or None
            The file, gzipped or not; None takes it from an installed package.
        context : int

        Raises
        ------
        SetupError
            There is no such file, or it is not CLIP's.
        """
        return cls(read_merges(path or installed_vocabulary()), context)

    def clean(self, text: str) -> str:
        """Text as the vocabulary knows it: repaired, on one line, in lower case."""
        plain = html.unescape(html.unescape(self._repair(text)))
        return " ".join(plain.split()).lower()

    def encode(self, text: str) -> list[int]:
        """Ids of a text, between start and end token, not padded.

        Raises
        ------
        TooLong
            There are more than `context`. (CLIP refuses these, too; some other tokenizers cut them.)
        """
        ids = [self.start]
        for word in self._words.findall(self.clean(text)):
            ids.extend(self._id[token] for token in self._merged(word))
        ids.append(self.end)
        if len(ids) > self.context:
            raise TooLong(f"{len(ids)} tokens with start and end; {self.context} fit")
        return ids

    def _merged(self, word: str) -> list[str]:
        """The tokens of one word."""
        symbols = [self._symbol[byte] for byte in word.encode()]
        symbols[-1] += WORD_END
        while len(symbols) > 1:
            first = min(itertools.pairwise(symbols), key=lambda pair: self._rank.get(pair, len(self._rank)))
            if first not in self._rank:
                break
            symbols = _merge(symbols, first)
        return symbols


def _merge(symbols: list[str], pair: tuple[str, str]) -> list[str]:
    """Join every occurrence of a pair, from the left."""
    merged: list[str] = []
    rest = iter(range(len(symbols)))
    for i in rest:
        if tuple(symbols[i : i + 2]) == pair:
            merged.append("".join(pair))
            next(rest)
        else:
            merged.append(symbols[i])
    return merged


@functools.cache
def extra(package: str) -> Any:
    """A package of the extra ``lseg``, imported when it is first needed.

    Raises
    ------
    SetupError
        It is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError:
        raise SetupError(f"the encoder lseg needs the package {package}: {INSTALL}") from None


def installed_vocabulary() -> Path:
    """CLIP's vocabulary file in an installed package; no package is imported for it.

    Raises
    ------
    SetupError
        No package has it.
    """
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            if (file := Path(folder) / FILE_NAME).is_file():
                return file
    raise SetupError(
        f"CLIP's vocabulary {FILE_NAME} is in no installed package: {INSTALL}, or name the file in REVISIT_BPE"
    )


def read_merges(path: Path) -> list[tuple[str, str]]:
    """The merges of CLIP's vocabulary file, which begins with a line of comment and holds more than CLIP uses.

    Raises
    ------
    SetupError
        The file cannot be read, or its merges are not CLIP's: ids, and so every text vector, would be wrong.
    """
    try:
        data = path.read_bytes()
        text = (gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data).decode()
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise SetupError(f"vocabulary {path}: cannot be read as (gzipped) UTF-8 text: {error}") from None
    lines = text.split("\n")[1 : MERGES + 1]
    seen = hashlib.sha256("\n".join(lines).encode()).hexdigest()
    if seen != MERGES_SHA256:
        raise SetupError(
            f"vocabulary {path} is not CLIP's: expected {MERGES} merges with SHA-256 {MERGES_SHA256}, saw {len(lines)} "
            f"with {seen}; the right file is {FILE_NAME}, which the extra `lseg` installs"
        )
    return [(a, b) for a, b in (line.split() for line in lines)]
