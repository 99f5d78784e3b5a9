"""Registers of the kernels in a cubin, the machine code of a GPU."""

from __future__ import annotations

import struct
from pathlib import Path

_WITH_VALUES = 4  # format of a record: kind, then the number of bytes, then these
_REGISTERS = 0x2F  # kind of a record: number of a symbol, and the registers of its threads


def registers(path: Path) -> dict[str, int]:
    """Read the number of registers of a thread, by the name of the kernel's entry.

    They are in the section ``.nv.info``, whose records `cuobjdump --dump-elf` lists as EIATTR_REGCOUNT.

    Args:
        path: A 64-bit little-endian ELF file, as `wp.compile_aot_module` writes it.
    """
    data = path.read_bytes()
    sections = _sections(data)
    symbols, names, info = sections[".symtab"], sections[".strtab"], sections[".nv.info"]
    found, at = {}, 0
    while at < len(info):
        layout, kind, size = struct.unpack_from("<2BH", info, at)
        if (layout, kind) == (_WITH_VALUES, _REGISTERS):
            symbol, count = struct.unpack_from("<2I", info, at + 4)
            found[_text(names, struct.unpack_from("<I", symbols, 24 * symbol)[0])] = count
        at += 4 + (size if layout == _WITH_VALUES else 0)
    return found


def warps(count: int) -> int:
    """Compute how many warps a multiprocessor of 65,536 registers holds, of threads with ``count`` each; at most 64."""
    return min(64, 65536 // (32 * (-(-count // 8) * 8)))


def _sections(data: bytes) -> dict[str, bytes]:
    """Read the sections of an ELF file by name."""
    [start] = struct.unpack_from("<Q", data, 40)
    size, count, names = struct.unpack_from("<3H", data, 58)
    headers = [struct.unpack_from("<2I4Q", data, start + size * number) for number in range(count)]
    contents = [data[offset : offset + length] for *_, offset, length in headers]
    return {_text(contents[names], header[0]): content for header, content in zip(headers, contents, strict=True)}


def _text(strings: bytes, begin: int) -> str:
    """Read a string that ends in a zero."""
    return strings[begin : strings.index(b"\0", begin)].decode()
