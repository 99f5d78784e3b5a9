"""The rows of an element of a PLY file: columns of numbers, and of lists.

Rows have no index in the file: where one begins follows from the counts of all lists before it. Where all lists of a
property are as long as the first one, rows lie at equal distances and columns are read as strided arrays. Otherwise a
loop follows the counts. Text is converted to float64 before, and read as binary numbers of this type.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..files import short, warn
from .header import Element, Header, Property

_BLOCK = 1 << 16  # rows of a block that is read together where their lengths differ
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}


def read_tables(path: Path, data: bytes, header: Header) -> dict[str, Table]:
    """Find the rows of all elements of a file, by name; raise ValueError if the file is damaged."""
    if header.order:
        return _tables(path, memoryview(data)[header.length :], header)[0]
    text, error = data[header.length :], None
    tables: dict[str, Table] = {}
    numbers = _numbers(path, text, header)
    try:
        tables, end = _tables(path, numbers.data.cast("B"), header)
        if end == numbers.nbytes:
            return tables
    except ValueError as wrong:
        error = wrong
    # Numbers are left, or missing: some programs write more of them in a line than the header declares.
    lines = _by_lines(path, text, header)
    if lines is not None:
        return _tables(path, lines.data.cast("B"), header)[0]
    if error is not None:
        raise error
    return tables


def _tables(path: Path, content: memoryview, header: Header) -> tuple[dict[str, Table], int]:
    """Find the rows of all elements in binary content, and the place after the last one."""
    tables: dict[str, Table] = {}
    place = 0
    for element in header.elements:
        table = Table(path, content, place, element, header.order)
        place = table.end
        tables.setdefault(element.name, table)
    return tables, place


def _numbers(path: Path, text: bytes, header: Header) -> np.ndarray:
    """Convert the text after a header to float64. What follows the last number is ignored."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            numbers = np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):  # something else than numbers follows
            numbers = np.fromiter(_leading(text), np.float64)
    least = sum(element.count * len(element.properties) for element in header.elements)
    if len(numbers) < least:
        words = text.split(None, len(numbers) + 1)
        got = short(words[len(numbers)].decode("latin-1")) if len(words) > len(numbers) else "the end of the file"
        raise ValueError(f"{path}: expected at least {least} numbers after the header, got {got} after {len(numbers)}")
    return numbers


def _leading(text: bytes) -> Iterator[float]:
    """Iterate over the numbers at the begin of a text."""
    for word in text.split():
        try:
            number = float(word)
        except ValueError:
            return
        yield number


def _by_lines(path: Path, text: bytes, header: Header) -> np.ndarray | None:
    """Convert the text after a header to float64, with a line for each row; None if lines do not fit.

    Surplus numbers at the end of a line are left out, with a warning.
    """
    lines = (words for line in text.splitlines() if (words := line.split()))
    found: list[bytes] = []
    longer = 0
    for element in header.elements:
        kinds = [part.count is not None for part in element.properties]
        for _ in range(element.count if kinds else 0):
            words, at = next(lines, []), 0
            for is_list in kinds:
                count = words[at] if is_list and at < len(words) else b"0"
                if not count.isdigit() or len(count) > 9:
                    return None
                at += 1 + int(count)
            if at > len(words):
                return None
            found += words[:at]
            longer += at < len(words)
    if longer:
        warn(f"{path}: {longer} lines have more numbers than their properties; those are left out")
    try:
        return np.array(found, np.float64)
    except ValueError:
        return None


@dataclass(frozen=True)
class _Place:
    """A property in each row: ``lead`` bytes after the row's begin, or after the end of its list number ``after``."""

    lead: int
    after: int
    type: np.dtype[Any]
    count: np.dtype[Any] | None  # of a list
    step: int = 0  # bytes from row to row, with ``lead`` from the first number of the table, where rows are equal
    size: int = 0  # numbers of each list, where rows are equal


class Table:
    """The rows of an element, from the byte ``begin`` of ``content`` to ``end``. Columns are read when used."""

    def __init__(self, path: Path, content: memoryview, begin: int, element: Element, order: str) -> None:
        self.name, self.count, self.begin = element.name, element.count, begin
        self.declared = {part.name: part.type for part in reversed(element.properties)}
        self._path, self._content, self._order = path, content, order
        self._places = self._layout(element.properties)
        self._lists = [place for place in self._places if place.count is not None]
        self._names = [part.name for part in element.properties]
        self._heads: np.ndarray | None = None  # [rows, lists], the place of each list's count
        self.end = begin
        least = sum((place.count or place.type).itemsize for place in self._places)
        if least * self.count > len(content) - begin:
            raise self._cut()
        if not least or not self.count or self._are_equal():
            return
        self._follow()

    def __contains__(self, name: str) -> bool:
        return name in self._names

    def numbers(self, *names: str) -> np.ndarray:
        """Return columns of numbers, [rows, columns], in their common type; at least one."""
        places = [self._places[self._names.index(name)] for name in names]
        common = np.result_type(*(place.type.newbyteorder("=") for place in places))
        result = np.empty((self.count, len(names)), common)
        for column, place in enumerate(places):
            if place.count is not None:
                raise ValueError(f"{self._path}: expected numbers as {names[column]} of {self.name}, got lists")
            result[:, column] = self._column(place)
        return result

    def lists(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return all values of a column of lists in a row, and how many each list has, [rows]."""
        place = self._places[self._names.index(name)]
        if place.count is None:
            raise ValueError(f"{self._path}: expected lists as {name} of {self.name}, got numbers")
        native = place.type.newbyteorder("=")
        if self._heads is None:
            sizes, width = np.full(self.count, place.size, np.int32), place.type.itemsize
            begin = place.lead + place.count.itemsize
            values = self._view(place.type, (self.count, place.size), begin, (place.step, width))
            return values.astype(native).reshape(-1), sizes
        sizes = self._sizes(place)
        starts = self._heads[:, self._lists.index(place)]
        values = np.empty(int(sizes.sum(dtype=np.int64)), native)
        known = self._at_any(place.type)
        begin = 0
        for first in range(0, self.count, _BLOCK):
            counts, some = sizes[first : first + _BLOCK], starts[first : first + _BLOCK] + place.count.itemsize
            offsets, total = np.cumsum(counts) - counts, int(counts.sum())
            where = np.repeat(some - offsets * place.type.itemsize, counts)
            where += np.arange(0, total * place.type.itemsize, place.type.itemsize)
            values[begin : begin + total] = known[where]
            begin += total
        return values, sizes

    def _layout(self, properties: list[Property]) -> list[_Place]:
        """Find where each property is in a row."""
        places, lead, after = [], 0, -1
        for part in properties:
            kinds = part.type, part.count
            if not self._order:
                kinds = "f8", None if part.count is None else "f8"
            order = self._order or "="
            kind, count = np.dtype(order + kinds[0]), None if kinds[1] is None else np.dtype(order + kinds[1])
            places.append(_Place(lead, after, kind, count))
            lead += kind.itemsize
            if count is not None:
                lead, after = 0, after + 1
        self._tail = lead  # bytes after the last list
        return places

    def _are_equal(self) -> bool:
        """Try whether each row is as long as the first one. If so, note where its properties are."""
        at, found = self.begin, []
        for place in self._places:
            size = 0
            if place.count is None:
                found.append(replace(place, lead=at))
                at += place.type.itemsize
                continue
            if at + place.count.itemsize > len(self._content):
                raise self._cut()
            size = self._whole(self._view(place.count, (1,), at, (0,))[0])
            found.append(replace(place, lead=at, size=size))
            at += place.count.itemsize + size * place.type.itemsize
        step = at - self.begin
        if self.begin + step * self.count > len(self._content):
            return False
        found = [replace(place, step=step) for place in found]
        for place in found:
            if place.count is not None:
                counts = self._view(place.count, (self.count,), place.lead, (step,))
                if not (counts == place.size).all():
                    return False
        self._places, self.end = found, self.begin + step * self.count
        return True

    def _follow(self) -> None:
        """Find the counts of all lists, one after the other."""
        try:
            heads = np.fromiter(self._walk(), np.int64, self.count * len(self._lists))
        except (IndexError, struct.error, ValueError, OverflowError):
            raise self._cut() from None
        self._heads = heads.reshape(self.count, -1)
        if self._heads.min() < self.begin or self._heads.max() >= len(self._content):
            raise self._cut()
        sizes = [self._sizes(place) for place in self._lists]
        last: Any = self._lists[-1]
        length = last.count.itemsize + int(sizes[-1][-1]) * last.type.itemsize + self._tail
        self.end = int(self._heads[-1, -1]) + length
        if self.end > len(self._content):
            raise self._cut()

    def _walk(self) -> Iterator[int]:
        """Iterate over the places of the counts of all lists, row by row."""
        data, at, tail = self._content, self.begin, self._tail
        steps = [(each.lead, each.count.itemsize, each.type.itemsize, self._count_at(each)) for each in self._lists]  # type: ignore[union-attr]
        if len(steps) == 1 and steps[0][1] == 1 and self._lists[0].count == np.uint8:
            (lead, size, width, _), at = steps[0], at + steps[0][0]
            step = lead + size + tail
            for _ in range(self.count):
                yield at
                at += step + width * data[at]
            return
        for _ in range(self.count):
            for lead, size, width, count_at in steps:
                at += lead
                yield at
                at += size + width * int(count_at(data, at)[0])
            at += tail

    def _count_at(self, place: _Place) -> Callable[[Any, int], tuple[Any, ...]]:
        kind: Any = place.count
        return struct.Struct((self._order or "=") + _CODES[kind.str[1:]]).unpack_from

    def _sizes(self, place: _Place) -> np.ndarray:
        """Return the counts of the lists of a property, [rows]."""
        kind: Any = place.count
        heads = self._heads[:, self._lists.index(place)]  # type: ignore[index]
        if int(heads.max()) + kind.itemsize > len(self._content):
            raise self._cut()
        counts = np.concatenate([self._at_any(kind)[heads[n : n + _BLOCK]] for n in range(0, len(heads), _BLOCK)])
        if counts.max(initial=0) > len(self._content):
            raise self._cut()
        if kind.kind != "u":
            for count in counts[(counts < 0) | (counts != np.floor(counts))][:1]:
                self._whole(count)
        sizes: np.ndarray = counts.astype(np.int32 if len(self._content) < 2**31 else np.int64)
        return sizes

    def _whole(self, count: Any) -> int:
        """Convert the count of a list; raise ValueError if it is none."""
        if not (count >= 0 and count == np.floor(count) and count < len(self._content) + 1):
            got = f"{float(count):g}"
            raise ValueError(f"{self._path}: expected lists of at least 0 numbers in {self.name}, got a count of {got}")
        return int(count)

    def _column(self, place: _Place) -> np.ndarray:
        if self._heads is None:
            return self._view(place.type, (self.count,), place.lead, (place.step,))
        if place.after < 0:
            starts = self._heads[:, 0] - self._lists[0].lead
        else:
            before = self._lists[place.after]
            width = before.count.itemsize  # type: ignore[union-attr]
            starts = self._heads[:, place.after] + width + self._sizes(before).astype(np.int64) * before.type.itemsize
        return self._at_any(place.type)[starts + place.lead]

    def _view(self, kind: Any, shape: tuple[int, ...], begin: int, strides: tuple[int, ...]) -> np.ndarray:
        if 0 in shape:
            return np.empty(shape, kind)
        return np.ndarray(shape, kind, self._content, begin, strides)

    def _at_any(self, kind: Any) -> np.ndarray:
        """View the content as a number that begins at each of its bytes."""
        return np.ndarray(max(len(self._content) - kind.itemsize + 1, 0), kind, self._content, 0, (1,))

    def _cut(self) -> ValueError:
        return ValueError(f"{self._path}: expected {self.count} rows of {self.name}, got fewer; the file is cut")
