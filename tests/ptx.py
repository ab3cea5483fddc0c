"""PTX as C, one instruction after the other: what a card would run is run on this processor.

Registers hold bits. Only what occurs is known; another instruction is an error with its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

HEAD = r"""
#include <math.h>
#include <stdint.h>
#include <string.h>
typedef union { double number; uint64_t bits; } both;
static double D(uint64_t bits) { both x; x.bits = bits; return x.number; }
static uint64_t B(double number) { both x; x.number = number; return x.bits; }
static uint64_t load(uint64_t place, int size) { uint64_t x = 0; memcpy(&x, (void *)place, size); return x; }
static void store(uint64_t place, uint64_t x, int size) { memcpy((void *)place, &x, size); }
uint32_t block_number(void), thread_number(void), threads_of_block(void);
void wait_for_warp(void);
int any_of_warp(int condition);
extern unsigned char memory_of_block[];
#define UNORDERED(a, b) (isnan(D(a)) || isnan(D(b)))
"""

#: Of operands {a}, {b} and {c}; {s} is the type of an integer of the instruction, {n} its bits.
RULES = {
    "rn.f64": {
        "add": "B(D({a}) + D({b}))",
        "sub": "B(D({a}) - D({b}))",
        "mul": "B(D({a}) * D({b}))",
        "div": "B(D({a}) / D({b}))",
        "fma": "B(fma(D({a}), D({b}), D({c})))",
        "rcp": "B(1.0 / D({a}))",
        "sqrt": "B(sqrt(D({a})))",
    },
    "f64": {
        "neg": "{a} ^ (1ull << 63)",
        "abs": "{a} & ~(1ull << 63)",
        "max": "B(fmax(D({a}), D({b})))",
        "min": "B(fmin(D({a}), D({b})))",
        "copysign": "({a} & (1ull << 63)) | ({b} & ~(1ull << 63))",
    },
    "integer": {
        "mov": "{a}",
        "add": "{a} + {b}",
        "sub": "{a} - {b}",
        "mul.lo": "{a} * {b}",
        "mad.lo": "{a} * {b} + {c}",
        "mul.hi": "(uint64_t)(((unsigned __int128)({s}){a} * (unsigned __int128)({s}){b}) >> {n})",
        "mul.wide": "(uint64_t)({s}){a} * (uint64_t)({s}){b}",
        "neg": "0 - {a}",
        "abs": "({s}){a} < 0 ? 0 - {a} : {a}",
        "not": "~{a}",
        "and": "{a} & {b}",
        "or": "{a} | {b}",
        "xor": "{a} ^ {b}",
        "shl": "{b} >= {n} ? 0 : {a} << {b}",
        "max": "({s}){a} > ({s}){b} ? {a} : {b}",
        "min": "({s}){a} < ({s}){b} ? {a} : {b}",
        "bfe": "({a} >> {b}) & ((1ull << {c}) - 1)",
        "clz": "{a} == 0 ? {n} : (uint64_t)__builtin_clzll((uint64_t){a} << (64 - {n}))",
        "shf.l.wrap": "{c} % 32 == 0 ? {b} : ({b} << ({c} % 32)) | ({a} >> (32 - {c} % 32))",
        "selp": "{c} ? {a} : {b}",
    },
}

#: Conversions by their kinds.
CONVERSIONS = {
    "rn.f64.u64": "B((double)(uint64_t){a})",
    "rn.f64.s64": "B((double)(int64_t){a})",
    "rn.f64.s32": "B((double)(int32_t){a})",
    "rn.f64.u32": "B((double)(uint32_t){a})",
    "rzi.s64.f64": "(uint64_t)(int64_t)D({a})",
    "rmi.f64.f64": "B(floor(D({a})))",
    "rpi.f64.f64": "B(ceil(D({a})))",
    "rzi.f64.f64": "B(trunc(D({a})))",
    "rni.f64.f64": "B(rint(D({a})))",
}

_COMPARED = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_SIGNED = {"16": "int16_t", "32": "int32_t", "64": "int64_t"}
_SPECIAL = {"%ctaid.x": "block_number()", "%ntid.x": "threads_of_block()", "%tid.x": "thread_number()"}
_REGISTERS = {"pred": "int", "b16": "uint16_t", "b32": "uint32_t", "b64": "uint64_t"}

_FUNCTION = re.compile(
    r"^(?:\.visible )?\.(?P<kind>func|entry)\s+(?P<returned>\(.*?\))?\s*(?P<name>[\w$]+)\s*\((?P<given>.*?)\)\s*"
    r"(?P<notes>(?:\.\w+[^\n{;]*\n)*)\{(?P<body>.*?)^\}",
    re.DOTALL | re.MULTILINE,
)
_GLOBAL = re.compile(
    r"^\.(?:visible )?(?:global|const) \.align (\d+) \.b8 (\w+)\[(\d+)\] = \{(.*?)\};", re.MULTILINE
)


def in_c(ptx: str) -> str:
    """C of all functions; what a thread knows of its block and of the others are functions of `tests.card`."""
    ptx = re.sub(r"//[^\n]*", "", ptx)
    lines = [HEAD]
    lines += [
        f"#define {name} memory_of_block"
        for name in re.findall(r"^\.extern \.shared .* (\w+)\[\];", ptx, re.M)
    ]
    lines += [
        f"static const unsigned char {name}[{size}] __attribute__((aligned({align}))) = {{{numbers}}};"
        for align, name, size, numbers in _GLOBAL.findall(ptx)
    ]
    found = list(_FUNCTION.finditer(ptx))
    heads = [_head(match) for match in found]
    lines += [f"{head};" for head in heads]
    for match, head in zip(found, heads):
        lines += [f"{head}\n{{", *_body(match["body"], match["returned"] is not None), "}"]
    return "\n".join(lines) + "\n"


def _head(match: re.Match[str]) -> str:
    given = [f"uint64_t {name}" for name in re.findall(r"(\w+)\s*(?:,|$)", match["given"].strip())]
    entry = match["kind"] == "entry"
    kind = "uint64_t" if match["returned"] else "void"
    return f"{'' if entry else 'static '}{kind} {match['name']}({', '.join(given) or 'void'})"


def _body(body: str, returns: bool) -> Iterator[str]:
    yield "uint64_t cc = 0, func_retval0 = 0; (void)cc; (void)func_retval0;"
    statement = ""
    for line in body.splitlines():
        statement = " ".join([*statement.split(), *line.split()])
        if not statement or not (statement in "{}" or statement[-1] in ";:"):
            continue
        yield _line_of(statement, returns)
        statement = ""


def _line_of(statement: str, returns: bool) -> str:
    if statement in "{}":
        return statement
    if statement.endswith(":"):
        return f"{_label(statement[:-1])}:;"
    if statement.startswith(".pragma"):
        return ""
    if statement.startswith("."):
        return _declared(statement)
    return _instruction(statement.rstrip(";"), returns)


def _label(name: str) -> str:
    return name.replace("$", "")


def _declared(statement: str) -> str:
    if match := re.fullmatch(r"\.reg \.(\w+) %(\w+)<(\d+)>;", statement):
        kind, name, count = match.groups()
        return f"{_REGISTERS[kind]} {', '.join(f'{name}{k} = 0' for k in range(int(count)))};"
    if match := re.fullmatch(r"\.reg \.b64 %(\w+);", statement):
        return f"uint64_t {match[1]} = 0;"
    if match := re.fullmatch(r"\.local \.align (\d+) \.b8 (\w+)\[(\d+)\];", statement):
        return f"unsigned char {match[2]}[{match[3]}] __attribute__((aligned({match[1]})));"
    if match := re.fullmatch(r"\.param \.b(?:32|64) (\w+);", statement):
        return f"uint64_t {match[1]} = 0;"
    raise AssertionError(f"unknown in PTX: {statement}")


def _value(text: str) -> str:
    text = text.strip()
    if text in _SPECIAL:
        return _SPECIAL[text]
    if text.startswith("%"):
        return text[1:]
    if text.startswith("0d"):
        return f"0x{text[2:]}ull"
    if re.fullmatch(r"-?\d+", text):
        return f"(uint64_t)({text}ll)" if text != "-9223372036854775808" else "(1ull << 63)"
    return f"(uint64_t)&{text}"  # a local array, a constant, or an argument


def _place(text: str) -> str:
    base, _, offset = text.strip("[] ").partition("+")
    return f"{_value(base)} + ({offset or 0})"


def _instruction(text: str, returns: bool) -> str:
    guard = ""
    if text.startswith("@"):
        predicate, text = text.split(" ", 1)
        guard = f"if ({'!' * ('!' in predicate)}{predicate.lstrip('@!%')}) "
    name, _, rest = text.partition(" ")
    operands = [part.strip() for part in re.findall(r"\s*(\([^)]*\)|\{[^}]*\}|[^,]+)", rest)]
    return guard + _line(name, operands, returns)


def _line(name: str, operands: list[str], returns: bool) -> str:
    first, *kinds = name.split(".")
    if first == "bra":
        return f"goto {_label(operands[0])};"
    if first == "ret":
        return f"return{' func_retval0' * returns};"
    if first == "call":
        result, function, given = (
            (operands[0], operands[1], operands[2:])
            if operands[0].startswith("(")
            else ("", operands[0], operands[1:])
        )
        call = f"{function}{given[0] if given else '()'};"
        return f"{result.strip('() ')} = {call}" if result else call
    if name in ("bar.warp.sync", "vote.sync.any.pred"):  # of all threads of a warp
        assert operands[-1] == "-1", name
        return (
            "wait_for_warp();"
            if first == "bar"
            else f"{_value(operands[0])} = any_of_warp({_value(operands[1])});"
        )
    if first in ("ld", "st"):
        return _moved(first, kinds, operands)
    if first == "cvta":
        return f"{_value(operands[0])} = {_value(operands[1])};"
    if first == "setp":
        return _compared(kinds, operands)
    if first == "mov" and operands[0].startswith("{"):
        low, high = operands[0].strip("{} ").split(",")
        source = _value(operands[1])
        return f"{_value(low)} = (uint32_t){source}; {_value(high)} = (uint32_t)({source} >> 32);"
    if first == "mov" and operands[1].startswith("{"):
        low, high = map(_value, operands[1].strip("{} ").split(","))
        return f"{_value(operands[0])} = ((uint64_t){high} << 32) | {low};"
    target, *values = map(_value, operands)
    if "cc" in kinds or first in ("addc", "subc"):
        return _carried(first, target, values)
    names = dict(zip("abc", values))
    if first == "cvt":
        rule = CONVERSIONS.get(".".join(kinds)) or _whole(kinds)
        return f"{target} = {rule.format(**names)};"
    return f"{target} = {_rule(first, kinds).format(**names, **_sizes(kinds[-1]))};"


def _sizes(kind: str) -> dict[str, str]:
    size = re.sub(r"\D", "", kind) or "64"
    signed = _SIGNED.get(size, "int64_t")
    return {"n": size, "s": f"u{signed}" if kind.startswith("u") else signed}


def _rule(first: str, kinds: list[str]) -> str:
    kind = ".".join(kinds)
    if kind in RULES and first in RULES[kind]:
        return RULES[kind][first]
    if first == "shr":
        signed = _SIGNED[kind[1:]] if kind[0] == "s" else f"u{_SIGNED[kind[1:]]}"
        last = "{n} - 1" if kind[0] == "s" else "0"
        past = f"({signed}){{a}} >> ({last})" if kind[0] == "s" else "0"
        return f"{{b}} >= {{n}} ? {past} : ({signed}){{a}} >> {{b}}"
    if kind == "pred":
        return {"mov": "{a}", "and": "{a} && {b}", "or": "{a} || {b}", "xor": "{a} != {b}", "not": "!{a}"}[
            first
        ]
    long = ".".join([first, *kinds[:-1]])
    found = RULES["integer"].get(long)
    assert found is not None, f"unknown in PTX: {first}.{kind}"
    return found


def _whole(kinds: list[str]) -> str:
    to, source = kinds
    assert to[0] in "us", f"unknown in PTX: cvt.{to}.{source}"
    assert source[0] in "us", f"unknown in PTX: cvt.{to}.{source}"
    inner = _SIGNED[source[1:]] if source[0] == "s" else f"u{_SIGNED[source[1:]]}"
    return f"(u{_SIGNED[to[1:]]})({inner}){{a}}"


def _compared(kinds: list[str], operands: list[str]) -> str:
    how, kind = kinds
    target, a, b = map(_value, operands)
    if kind != "f64":
        as_kind = _SIGNED[kind[1:]] if kind[0] == "s" else f"u{_SIGNED[kind[1:]]}"
        return f"{target} = ({as_kind}){a} {_COMPARED[how]} ({as_kind}){b};"
    if how in ("nan", "num"):
        return f"{target} = {'!' * (how == 'num')}UNORDERED({a}, {b});"
    if how.endswith("u"):
        return f"{target} = UNORDERED({a}, {b}) || D({a}) {_COMPARED[how[:-1]]} D({b});"
    ordered = f"!UNORDERED({a}, {b}) && " if how == "ne" else ""
    return f"{target} = {ordered}D({a}) {_COMPARED[how]} D({b});"


def _carried(first: str, target: str, values: list[str]) -> str:
    """Sums of 64 bits with a carry, differences with a borrow."""
    a, b = values
    sign = "+" if first.startswith("add") else "-"
    carry = " + cc" * (first == "addc") + " - cc" * (first == "subc")
    wide = f"(unsigned __int128){a} {sign} {b}{carry}"
    return f"{{ unsigned __int128 w = {wide}; {target} = (uint64_t)w; cc = (uint64_t)(w >> 64) & 1; }}"


def _moved(first: str, kinds: list[str], operands: list[str]) -> str:
    memory, register = (operands[1], operands[0]) if first == "ld" else operands
    if "param" in kinds:
        place = memory.strip("[] ")
        if place.startswith("%"):  # the address of an argument, chosen among several
            return f"{_value(register)} = load({_place(memory)}, 8);"
        return f"{_value(register)} = {place};" if first == "ld" else f"{place} = {_value(register)};"
    size = int(re.sub(r"\D", "", kinds[-1])) // 8
    registers = register.strip("{} ").split(",")
    lines = list[str]()
    for k, each in enumerate(registers):
        place = f"{_place(memory)} + {k * size}"
        lines.append(
            f"{_value(each)} = load({place}, {size});"
            if first == "ld"
            else f"store({place}, {_value(each)}, {size});"
        )
    return " ".join(lines)
