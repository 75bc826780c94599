"""Just enough of MATLAB's level 5 MAT-files to read a table of names and numbers.

Format: "MAT-File Format", The MathWorks, level 5. Read: numeric, char, cell and struct arrays, compressed or not.
A dependency of 100 MB for two arrays and two lists of names would be out of proportion.
"""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Data types of elements (mi...) that hold numbers, as numpy writes them."""

TEXTS = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, CHAR = 1, 2, 4
COMPLEX = 0x0800


class NotMatlab(ValueError):
    """The file is no level 5 MAT-file, or holds something that is not read here."""


def read_matlab(path: Path) -> dict[str, Any]:
    """The variables of a MAT-file.

    Returns
    -------
    dict
        Numeric arrays as numpy arrays in MATLAB's shape; char arrays as str (rows joined); cell arrays as lists in
        column-major order; 1 x 1 structs as dicts, larger ones as lists of dicts.

    Raises
    ------
    NotMatlab
    """
    data = path.read_bytes()
    if data.startswith(b"\x89HDF") or b"MATLAB 7.3" in data[:128]:
        raise NotMatlab("a MAT-file of version 7.3; save it with -v7")
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI"):
        raise NotMatlab("not a level 5 MAT-file")
    order = "<" if data[126:128] == b"IM" else ">"
    found: dict[str, Any] = {}
    try:
        _variables(data, 128, order, found)
    except (struct.error, zlib.error, IndexError, UnicodeDecodeError, ValueError) as error:
        raise error if isinstance(error, NotMatlab) else NotMatlab(f"damaged MAT-file: {error}") from None
    return found


def _variables(data: bytes, at: int, order: str, found: dict[str, Any]) -> None:
    while at + 8 <= len(data):
        kind, content, at = _element(data, at, order)
        if kind == COMPRESSED:
            _variables(zlib.decompress(content), 0, order, found)
        elif kind == MATRIX:
            name, value = _matrix(content, order)
            found[name] = value


def _element(data: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """(data type, bytes, where the next element begins)."""
    kind, size = struct.unpack_from(order + "II", data, at)
    if kind >> 16:  # small element: size and up to four bytes share the tag
        return kind & 0xFFFF, data[at + 4 : at + 4 + (kind >> 16)], at + 8
    start = at + 8
    if start + size > len(data):
        raise NotMatlab("damaged MAT-file: it ends within an element")
    # Elements are padded to 8 bytes, compressed ones are not.
    return kind, data[start : start + size], start + size + (0 if kind == COMPRESSED else -size % 8)


def _matrix(content: bytes, order: str) -> tuple[str, Any]:
    """(name, value) of one array; an empty element is an empty array."""
    if not content:
        return "", np.zeros((0, 0))
    _, flags, at = _element(content, 0, order)
    (bits,) = struct.unpack_from(order + "I", flags)
    _, sizes, at = _element(content, at, order)
    shape = tuple(int(n) for n in np.frombuffer(sizes, order + "i4"))
    _, name, at = _element(content, at, order)
    kind, count = bits & 0xFF, int(np.prod(shape))
    if kind == CELL:
        cells = []
        for _ in range(count):
            _, inner, at = _element(content, at, order)
            cells.append(_matrix(inner, order)[1])
        return name.decode("ascii"), cells
    if kind == STRUCT:
        return name.decode("ascii"), _struct(content, at, count, order)
    if kind == CHAR or 6 <= kind <= 15:
        stored, numbers, _ = _element(content, at, order)
        if bits & COMPLEX:
            raise NotMatlab("complex numbers are not read")
        if kind == CHAR:
            return name.decode("ascii"), _text(stored, numbers, shape, order)
        return name.decode("ascii"), np.frombuffer(numbers, order + NUMBERS[stored]).reshape(shape, order="F")
    raise NotMatlab(f"arrays of class {kind} are not read (cell, struct, char and numbers are)")


def _struct(content: bytes, at: int, count: int, order: str) -> Any:
    _, width, at = _element(content, at, order)
    (length,) = struct.unpack_from(order + "i", width)
    _, names, at = _element(content, at, order)
    fields = [names[i : i + length].split(b"\0")[0].decode("ascii") for i in range(0, len(names), length)]
    items = []
    for _ in range(count):
        item = {}
        for field in fields:
            _, inner, at = _element(content, at, order)
            item[field] = _matrix(inner, order)[1]
        items.append(item)
    return items[0] if count == 1 else items


def _text(stored: int, raw: bytes, shape: tuple[int, ...], order: str) -> str:
    """Characters lie column by column; a row vector, the usual case, reads straight through."""
    if stored in TEXTS:
        letters = raw.decode(TEXTS[stored] + ("" if stored == 16 else "-le" if order == "<" else "-be"))
    else:
        letters = "".join(map(chr, np.frombuffer(raw, order + NUMBERS[stored])))
    if shape[0] <= 1:
        return letters
    return "".join(letters[row :: shape[0]] for row in range(shape[0]))
