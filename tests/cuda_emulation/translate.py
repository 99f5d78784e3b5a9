"""Translation of PTX kernels to C, one function a kernel.

A register is a union of all types (``Register`` in runtime.h). Integers are stored sign- or zero-extended to 64 bits,
so that a narrower read finds its value.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from .ptx import Instruction, Kernel, identifier

RUNTIME = Path(__file__).with_name("runtime.h")

_C = {"f32": "float", "f64": "double"} | {
    f"{sign}{bits}": f"{'' if sign == 's' else 'u'}int{bits}_t" for sign in "su" for bits in (8, 16, 32, 64)
}
_COMPARE = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "lo": "<", "ls": "<=", "hi": ">"}
_COMPARE |= {"hs": ">="}
_OPPOSITE = {"eq": "ne", "ne": "eq", "lt": "ge", "le": "gt", "gt": "le", "ge": "lt"}
_SPECIAL = {
    "%tid.x": "thread.x",
    "%ctaid.x": "thread.block",
    "%ntid.x": "thread.block_size",
    "%nctaid.x": "thread.blocks",
    **dict.fromkeys(("%tid.y", "%tid.z", "%ctaid.y", "%ctaid.z"), "0"),
    **dict.fromkeys(("%ntid.y", "%ntid.z", "%nctaid.y", "%nctaid.z"), "1"),
}
_BINARY = {"add": "+", "sub": "-", "and": "&", "or": "|", "xor": "^"}
_FLOAT_CALLS = {"sqrt": "sqrt", "abs": "fabs", "min": "fmin", "max": "fmax", "sin": "sin", "cos": "cos"}
_FLOAT_CALLS |= {"lg2": "log2", "ex2": "exp2", "fma": "fma"}
_ROUND = {"rmi": "floor", "rpi": "ceil", "rzi": "trunc", "rni": "rint"}


def translate(kernels: list[Kernel]) -> str:
    """Write the C source of a module: runtime, kernels and a table of them by name."""
    functions = "\n".join(_function(kernel) for kernel in kernels)
    table = "\n".join(f'    {{"{kernel.name}", {kernel.name}}},' for kernel in kernels)
    return (
        f"{RUNTIME.read_text(encoding='utf-8')}\n{functions}\n"
        f"static const struct {{ const char* name; Function function; }} KERNELS[] = {{\n{table}\n}};\n"
        "Function find(const char* name) {\n"
        "    for (unsigned i = 0; i < sizeof(KERNELS) / sizeof(*KERNELS); ++i)\n"
        "        if (!strcmp(KERNELS[i].name, name)) return KERNELS[i].function;\n"
        "    return 0;\n}\n"
    )


def _function(kernel: Kernel) -> str:
    lines = [f"static void {kernel.name}(char** parameters, Thread thread) {{"]
    registers = [*kernel.registers, "SP", "SPL"]
    lines.append(f"    Register {', '.join(f'{name} = {{0}}' for name in registers)};")
    lines.append(f"    char local[{max(kernel.local_bytes, 1)}] __attribute__((aligned(16))), shared[4096];")
    for statement in kernel.body:
        if isinstance(statement, str):
            lines.append(f"{statement}: ;")
            continue
        code = _instruction(statement)
        lines.append(f"    if ({statement.guard}) {{ {code} }}" if statement.guard else f"    {code}")
    return "\n".join([*lines, "}"])


def _instruction(one: Instruction) -> str:
    name = one.operation[0]
    if name in ("bra", "ret"):
        return "return;" if name == "ret" else f"goto {identifier(one.operands[0])};"
    writer = _WRITERS.get(name)
    if writer is None:
        raise NotImplementedError(f"PTX instruction: expected one that is emulated, got {'.'.join(one.operation)}")
    return writer(one)


def _plain(kind: str) -> str:
    """Name the type of untyped bits: b32 is u32."""
    return f"u{kind[1:]}" if kind[0] == "b" else kind


def _read(operand: str, kind: str) -> str:
    """Write an operand as a C expression of a PTX type."""
    kind = _plain(kind)
    if operand in _SPECIAL:
        return f"(({_C[kind]}){_SPECIAL[operand]})"
    if operand.startswith("%"):
        return f"{identifier(operand)}.{kind}"
    if real := re.fullmatch(r"0([fd])([0-9A-Fa-f]+)", operand):
        return f"{'as_f32' if real[1] == 'f' else 'as_f64'}(0x{real[2]}ull)"
    if re.fullmatch(r"-?(0x[0-9A-Fa-f]+|\d+)U?", operand):
        number = operand.rstrip("U")
        return number if kind == "pred" else f"(({_C[kind]}){number}{'ll' if number[0] == '-' else 'ull'})"
    raise NotImplementedError(f"PTX operand: expected a register or a number, got {operand}")


def _write(operand: str, kind: str, value: str) -> str:
    """Assign to a register; integers fill all of its 64 bits."""
    kind = _plain(kind)
    register = identifier(operand)
    if kind[0] in "su":
        return f"{register}.{kind[0]}64 = ({_C[kind]})({value});"
    return f"{register}.{kind} = {value};"


def _address(operand: str, space: str) -> str:
    found = re.fullmatch(r"\[\s*(%?[\w$.]+)\s*(?:\+\s*(-?\d+))?\s*\]", operand)
    if not found:
        raise NotImplementedError(f"PTX address: expected [base+offset], got {operand}")
    base, offset = found[1], found[2] or "0"
    if base.startswith("%"):
        pointer = f"{identifier(base)}.u64"
        return f"(shared + (uint32_t){pointer} + {offset})" if space == "shared" else f"((char*){pointer} + {offset})"
    if number := re.search(r"_param_(\d+)$", base):
        return f"(parameters[{number[1]}] + {offset})"
    return f"(shared + {offset})"  # the only other symbols are Warp's own, in shared memory


def _space(one: Instruction) -> str:
    return next((part for part in one.operation if part in ("param", "global", "local", "shared", "const")), "generic")


def _lanes(operand: str) -> list[str]:
    return [part.strip() for part in operand.strip("{}").split(",")]


def _load(one: Instruction) -> str:
    kind, space, lanes = one.operation[-1], _space(one), _lanes(one.operands[0])
    size = int(kind[1:]) // 8
    address = _address(one.operands[1], space)
    seen = f"READ({address}, {size * len(lanes)}); " if space in ("global", "generic") else ""
    parts = (
        _write(lane, kind, f"*({_C[_plain(kind)]}*)({address} + {number * size})") for number, lane in enumerate(lanes)
    )
    return seen + " ".join(parts)


def _store(one: Instruction) -> str:
    kind, space = _plain(one.operation[-1]), _space(one)
    size = int(kind[1:]) // 8
    address = _address(one.operands[0], space)
    parts = []
    for number, lane in enumerate(_lanes(one.operands[1])):
        place = f"({address} + {number * size})"
        value = f"{_C[kind]} value = {_read(lane, kind)};"
        seen = f" WRITE({place}, {size}, &value);" if space in ("global", "generic") else ""
        parts.append(f"{{ {value}{seen} *({_C[kind]}*){place} = value; }}")
    return " ".join(parts)


def _atomic(one: Instruction) -> str:
    kind = _plain(one.operation[-1])
    way = next(part for part in one.operation if part in ("add", "min", "max", "cas", "exch", "or", "and"))
    operands = one.operands if one.operation[0] == "atom" else ("", *one.operands)
    address = _address(operands[1], "global")
    values = ", ".join(_read(operand, kind) for operand in operands[2:])
    call = f"atomic_{way}_{kind}({address}, {values})"
    seen = f"ATOMIC({address}, {int(kind[1:]) // 8}, {int(way == 'add' and kind[0] == 'f')}); "
    return seen + (f"{call};" if operands[0] in ("", "_") else _write(operands[0], kind, call))


def _move(one: Instruction) -> str:
    kind, (target, source) = one.operation[-1], one.operands
    if target.startswith("{"):  # unpack
        lanes = _lanes(target)
        bits = int(kind[1:]) // len(lanes)
        value = _read(source, f"u{kind[1:]}")
        return " ".join(
            _write(lane, f"u{bits}", f"{value} >> {bits * number}") for number, lane in enumerate(lanes) if lane != "_"
        )
    if source.startswith("{"):  # pack
        lanes = _lanes(source)
        bits = int(kind[1:]) // len(lanes)
        parts = (f"(uint64_t){_read(lane, f'u{bits}')} << {bits * number}" for number, lane in enumerate(lanes))
        return _write(target, f"u{kind[1:]}", " | ".join(f"({part})" for part in parts))
    if source.startswith("__local_depot"):
        return _write(target, "u64", "(uint64_t)local")
    if number := re.search(r"_param_(\d+)$", source):
        return _write(target, "u64", f"(uint64_t)parameters[{number[1]}]")
    if re.match(r"[A-Za-z_]\w*$", source):
        return _write(target, "u64", "0")  # a symbol in shared memory
    return _write(target, kind, _read(source, kind))


def _convert(one: Instruction) -> str:
    to, source = _plain(one.operation[-2]), _plain(one.operation[-1])
    value = _read(one.operands[1], source)
    rounding = next((_ROUND[part] for part in one.operation[1:-2] if part in _ROUND), None)
    if source[0] == "f" and to[0] == "f":
        value = f"{rounding}({value})" if rounding else value
        value = f"saturate({value})" if "sat" in one.operation else value
        return _write(one.operands[0], to, f"({_C[to]})({value})")
    if source[0] == "f":
        return _write(one.operands[0], to, f"to_{to}({rounding or 'trunc'}((double){value}))")
    return _write(one.operands[0], to, f"({_C[to]}){value}")


def _compare(one: Instruction) -> str:
    kind, way = _plain(one.operation[-1]), one.operation[1]
    a, b = (_read(operand, kind) for operand in one.operands[1:3])
    if kind[0] != "f":
        test = f"{a} {_COMPARE[way]} {b}"
    elif way in ("nan", "num"):
        test = f"{'' if way == 'nan' else '!'}(isnan({a}) || isnan({b}))"
    elif way.endswith("u"):  # true where one is NaN
        opposite = _OPPOSITE[way[:-1]]
        test = f"{a} != {b}" if way == "neu" else f"!({_ordered(opposite, a, b)})"
    else:
        test = _ordered(way, a, b)
    for part, symbol in (("and", "&&"), ("or", "||"), ("xor", "^")):
        if part in one.operation[2:-1]:
            test = f"({test}) {symbol} {_read(one.operands[3], 'pred')}"
    return _write(one.operands[0], "pred", test)


def _ordered(way: str, a: str, b: str) -> str:
    return f"({a} < {b} || {a} > {b})" if way == "ne" else f"{a} {_COMPARE[way]} {b}"


def _select(one: Instruction) -> str:
    kind = one.operation[-1]
    yes, no, test = _read(one.operands[1], kind), _read(one.operands[2], kind), _read(one.operands[3], "pred")
    return _write(one.operands[0], kind, f"{test} ? {yes} : {no}")


def _arithmetic(one: Instruction) -> str:
    """Two operands and a C operator; integers wrap around, so they are computed unsigned."""
    kind = _plain(one.operation[-1])
    own = f"u{kind[1:]}" if kind[0] in "su" else kind
    a, b = (_read(operand, own) for operand in one.operands[1:3])
    symbol = _BINARY[one.operation[0]]
    return _write(one.operands[0], kind, f"({a} {symbol} {b})" if kind[0] in "fp" else f"({_C[own]})({a} {symbol} {b})")


def _shift(one: Instruction) -> str:
    kind = _plain(one.operation[-1])
    bits = int(kind[1:])
    value, by = _read(one.operands[1], kind), _read(one.operands[2], "u32")
    symbol = "<<" if one.operation[0] == "shl" else ">>"
    beyond = f"{value} >> {bits - 1}" if kind[0] == "s" and symbol == ">>" else "0"
    return _write(one.operands[0], kind, f"{by} >= {bits} ? {beyond} : {value} {symbol} {by}")


def _insert_bits(one: Instruction) -> str:
    """The lowest ``length`` bits of the first operand in place of those of the second one from ``start`` on."""
    kind = _plain(one.operation[-1])
    bits, into = (_read(operand, kind) for operand in one.operands[1:3])
    start, length = (_read(operand, "u32") for operand in one.operands[3:5])
    mask = f"((((uint64_t)1 << {length}) - 1) << {start})"
    return _write(one.operands[0], kind, f"({into} & ~{mask}) | (((uint64_t){bits} << {start}) & {mask})")


def _multiply(one: Instruction) -> str:
    kind, way = _plain(one.operation[-1]), one.operation[1]
    if kind[0] == "f":
        return _write(one.operands[0], kind, f"{_read(one.operands[1], kind)} * {_read(one.operands[2], kind)}")
    bits = int(kind[1:])
    wide = {128: "__int128" if kind[0] == "s" else "unsigned __int128"}.get(2 * bits) or _C[f"{kind[0]}{2 * bits}"]
    product = f"(({wide}){_read(one.operands[1], kind)} * ({wide}){_read(one.operands[2], kind)})"
    if way == "wide":
        return _write(one.operands[0], f"{kind[0]}{2 * bits}", product)
    if way == "hi":
        return _write(one.operands[0], kind, f"{product} >> {bits}")
    total = f"(uint64_t){product}"
    if one.operation[0] == "mad":
        total += f" + (uint64_t){_read(one.operands[3], kind)}"
    return _write(one.operands[0], kind, total)


def _divide(one: Instruction) -> str:
    kind = _plain(one.operation[-1])
    a, b = (_read(operand, kind) for operand in one.operands[1:3])
    symbol = "/" if one.operation[0] == "div" else "%"
    return _write(one.operands[0], kind, f"{a} / {b}" if kind[0] == "f" else f"{b} ? {a} {symbol} {b} : 0")


def _call(one: Instruction) -> str:
    """Functions of C's library; integers have the few of them that PTX knows."""
    kind, name = _plain(one.operation[-1]), one.operation[0]
    values = [_read(operand, kind) for operand in one.operands[1:]]
    if kind[0] == "f":
        suffix = "f" if kind == "f32" else ""
        return _write(one.operands[0], kind, f"{_FLOAT_CALLS[name]}{suffix}({', '.join(values)})")
    if name == "abs":
        return _write(one.operands[0], kind, f"{values[0]} < 0 ? -{values[0]} : {values[0]}")
    symbol = "<" if name == "min" else ">"
    return _write(one.operands[0], kind, f"{values[0]} {symbol} {values[1]} ? {values[0]} : {values[1]}")


def _unary(template: str) -> Callable[[Instruction], str]:
    def writer(one: Instruction) -> str:
        kind = one.operation[-1]
        return _write(one.operands[0], kind, template.format(_read(one.operands[1], kind)))

    return writer


def _not(one: Instruction) -> str:
    return _unary("!{}" if one.operation[-1] == "pred" else "~{}")(one)


def _copysign(one: Instruction) -> str:
    kind = one.operation[-1]
    sign, size = (_read(operand, kind) for operand in one.operands[1:3])
    return _write(one.operands[0], kind, f"copysign({size}, {sign})")


_WRITERS: dict[str, Callable[[Instruction], str]] = {
    **dict.fromkeys(("ld", "ldu"), _load),
    "st": _store,
    **dict.fromkeys(("atom", "red"), _atomic),
    "mov": _move,
    "cvta": _move,
    "cvt": _convert,
    "setp": _compare,
    "selp": _select,
    **dict.fromkeys(_BINARY, _arithmetic),
    **dict.fromkeys(("shl", "shr"), _shift),
    "bfi": _insert_bits,
    **dict.fromkeys(("mul", "mad"), _multiply),
    **dict.fromkeys(("div", "rem"), _divide),
    **dict.fromkeys(_FLOAT_CALLS, _call),
    "not": _not,
    "neg": _unary("-{}"),
    "rcp": _unary("1 / {}"),
    "copysign": _copysign,
}
