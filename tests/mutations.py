"""Damaged files: bytes changed anywhere, also inside of containers whose checksums are made right again."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st

# Values that break readers: numbers at the ends of their ranges, names that lead elsewhere, unclosed brackets.
TOKENS = [
    *(b"nan", b"inf", b"-inf", b"1e39", b"-1e308", b"1e999", b"0", b"-1", b"1", b"3", b"255", b"65536", b"2147483648"),
    *(b"99999999999999999999", b"-99999999999999999999", b"9" * 400, b"1e-45", b"0.1.2", b"+-1", b"0x10", b"1_000"),
    *(b"../x", b"/etc/hostname", b"\\..\\x", b"%2e%2e/x", b"/", b"..", b"\0", b"\n", b"\r", b"\\\n", b" ", b"\t", b"#"),
    *(
        b'"',
        b"'",
        b",",
        b":",
        b"[",
        b"]",
        b"{",
        b"}",
        b"[" * 3000,
        b"null",
        b"true",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\x80",
    ),
    *(
        b"\xff\xff\xff\xff",
        b"\x7f\xff\xff\xff",
        b"\0\0\0\0",
        b"\0\0\0\x80",
        b"x" * 300,
        b"/",
        b"//",
        b"f",
        b"v",
        b"-o 1",
    ),
]


@dataclass(frozen=True)
class Edit:
    """One change: of ``kind`` at the part ``place`` of the data."""

    kind: str
    place: float
    other: float
    length: int
    token: bytes

    def __call__(self, data: bytes) -> bytes:
        begin = int(self.place * len(data))
        end = min(len(data), begin + self.length)
        if self.kind == "flip" and begin < len(data):
            return data[:begin] + bytes([data[begin] ^ 1 << self.length % 8]) + data[begin + 1 :]
        if self.kind == "word":  # between the separators around it
            while begin > 0 and data[begin - 1 : begin] not in b" \n\t/,:\"'[]{}()":
                begin -= 1
            end = begin
            while end < len(data) and data[end : end + 1] not in b" \n\t/,:\"'[]{}()":
                end += 1
            return data[:begin] + self.token + data[end:]
        if self.kind == "insert":
            return data[:begin] + self.token + data[begin:]
        if self.kind == "overwrite":
            return data[:begin] + self.token + data[begin + len(self.token) :]
        if self.kind == "delete":
            return data[:begin] + data[end:]
        if self.kind == "repeat":
            return data[:begin] + data[begin:end] * (1 + self.length) + data[end:]
        if self.kind == "move":
            source = int(self.other * len(data))
            return data[:begin] + data[source : source + self.length] + data[end:]
        if self.kind == "cut":
            return data[:begin]
        return data


KINDS = ["flip", "word", "insert", "overwrite", "delete", "repeat", "move", "cut"]
PART = st.floats(0, 1, exclude_max=True)
EDITS = st.lists(
    st.builds(Edit, st.sampled_from(KINDS), PART, PART, st.integers(1, 60), st.sampled_from(TOKENS)),
    min_size=1,
    max_size=6,
)


def mutated(data: bytes, edits: Sequence[Edit]) -> bytes:
    for edit in edits:
        data = edit(data)
    return data


def plain(data: bytes, part: float, change: Callable[[bytes], bytes]) -> bytes:
    """Anywhere."""
    return change(data)


def png(data: bytes, part: float, change: Callable[[bytes], bytes]) -> bytes:
    """Change the inside of one chunk, with the right length and checksum; for pixels, the packed data."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    chosen = int(part * len(chunks))
    result = data[:8]
    for number, (kind, content) in enumerate(chunks):
        if number == chosen:
            content = zlib.compress(change(zlib.decompress(content))) if kind == b"IDAT" else change(content)
        result += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return result


def glb(data: bytes, part: float, change: Callable[[bytes], bytes]) -> bytes:
    """Inside the JSON or the numbers, whose lengths are right then."""
    size = struct.unpack("<I", data[12:16])[0]
    text, rest = data[20 : 20 + size], data[28 + size :]
    text, rest = (change(text), rest) if part < 0.8 else (text, change(rest))
    text, rest = text + b" " * (-len(text) % 4), rest + bytes(-len(rest) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(rest), b"BIN\0") + rest
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def archive(data: bytes, part: float, change: Callable[[bytes], bytes]) -> bytes:
    """Inside one member of a zip file, as npz and torch's checkpoints are, whose checksum is right then."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        return change(data)
    with zipfile.ZipFile(io.BytesIO(data)) as source:
        members = [(info, source.read(info)) for info in source.infolist()]
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w") as target:
        for number, (info, content) in enumerate(members):
            head = content[:300] if info.filename.endswith(".npy") else content  # the numbers after it may be any
            changed = change(head) + content[len(head) :] if number == int(part * len(members)) else content
            target.writestr(zipfile.ZipInfo(info.filename), changed, info.compress_type)
    return result.getvalue()


def damage(containers: Sequence[Any]) -> st.SearchStrategy[Callable[[bytes], bytes]]:
    """A change of a file: one of `plain`, `png`, `glb`, `archive` with edits."""

    def made(container: Any, part: float, edits: list[Edit]) -> Callable[[bytes], bytes]:
        return lambda data: container(data, part, lambda content: mutated(content, edits))

    return st.builds(made, st.sampled_from(containers), PART, EDITS)
