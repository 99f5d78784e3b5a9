"""Parser for the subset of PTX, NVIDIA's virtual machine code, that Warp's compiler makes of our kernels.

Reference: NVIDIA, "Parallel Thread Execution ISA".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

_SIZES = {"8": 1, "16": 2, "32": 4, "64": 8}
_ENTRY = re.compile(r"\.visible \.entry (\w+)\s*\((.*?)\)\s*(?:\.\w+[^{\n]*\n\s*)*\{(.*?)\n\}", re.DOTALL)
_DECLARATION = re.compile(r"^\s*\.(reg|local|shared|pragma|loc|file)\b[^;\n]*;?\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Instruction:
    """One instruction, such as ``@!%p1 add.rn.f32 %f1, %f2, 0f3F800000``.

    Attributes:
        operation: Parts of the opcode: ("add", "rn", "f32").
        operands: Operands as they are written: ("%f1", "%f2", "0f3F800000").
        guard: C condition of a predicated instruction, "" without one.
    """

    operation: tuple[str, ...]
    operands: tuple[str, ...]
    guard: str = ""


@dataclass(frozen=True)
class Kernel:
    """One entry point of a module.

    Attributes:
        name: Name of the entry point.
        parameters: Size of each parameter in bytes.
        registers: Names of all registers, without "%".
        local_bytes: Size of the thread's local memory.
        body: Labels (str) and instructions, in order.
    """

    name: str
    parameters: tuple[int, ...]
    registers: tuple[str, ...]
    local_bytes: int
    body: tuple[str | Instruction, ...]


def parse(text: str) -> list[Kernel]:
    """Parse the kernels of a PTX module."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.DOTALL)
    return [_kernel(*found.groups()) for found in _ENTRY.finditer(text)]


def identifier(name: str) -> str:
    """Make a C identifier of the name of a register or a label."""
    return name.replace("%", "").replace("$", "L_").replace(".", "_")


def _kernel(name: str, parameters: str, body: str) -> Kernel:
    registers = [
        f"{prefix}{number}"
        for prefix, count in re.findall(r"\.reg \.\w+\s+%(\w+)<(\d+)>;", body)
        for number in range(int(count))
    ]
    local = re.search(r"\.local[^;]*__local_depot\d+\[(\d+)\]", body)
    return Kernel(
        name=name,
        parameters=tuple(_parameter_size(one) for one in parameters.split(",")),
        registers=tuple(registers),
        local_bytes=int(local[1]) if local else 0,
        body=tuple(_statements(_DECLARATION.sub("", body))),
    )


def _parameter_size(declaration: str) -> int:
    block = re.search(r"\.b8 \w+\[(\d+)\]", declaration)
    if block:
        return int(block[1])
    scalar = re.search(r"\.param\s+\.[a-z](\d+)", declaration)
    if not scalar:
        raise ValueError(f"kernel parameter: expected a declaration, got {declaration!r}")
    return _SIZES[scalar[1]]


def _statements(body: str) -> Iterator[str | Instruction]:
    for statement in re.split(r"(?<=;)|(?<=:)\s*\n", body):
        statement = statement.strip()
        while label := re.match(r"(\$?[\w$]+):\s*", statement):
            yield identifier(label[1])
            statement = statement[label.end() :].strip()
        statement = statement.rstrip(";").strip()
        if statement in ("", "{", "}"):
            continue
        guard = ""
        if guarded := re.match(r"@(!?)(%\w+)\s+(.*)", statement, re.DOTALL):
            guard, statement = f"{guarded[1]}{identifier(guarded[2])}.pred", guarded[3]
        opcode, *operands = statement.split(None, 1)
        yield Instruction(tuple(opcode.split(".")), tuple(_operands(operands[0] if operands else "")), guard)


def _operands(text: str) -> Iterator[str]:
    """Split at commas outside of brackets and braces."""
    depth, start = 0, 0
    for place, character in enumerate(text):
        depth += (character in "{[") - (character in "}]")
        if character == "," and depth == 0:
            yield text[start:place].strip()
            start = place + 1
    if text[start:].strip():
        yield text[start:].strip()
