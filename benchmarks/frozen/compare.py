"""Differences between what two trees give, each with its name, both values, and how much it weighs."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from benchmarks.frozen.reasons import REASONS, Reason
from benchmarks.frozen.tree import CODE

#: Numbers that differ by less, relative to the largest of their list, differ by rounding: sums have another order.
ROUNDING = 1e-6

#: Groups of numbers that have to be equal to the bit: law and filter, as they are saved and as they run.
BITS = ("bits", "controller", "step")

#: Characters of a digest, and of another text, that tell it from another one.
DIGEST, LONG = 12, 60

#: ``bits`` is a law, a filter or γ that moved; ``verdict`` a requirement that is met or missed now; ``moved`` another
#: number or code; ``rounding`` one that moved by rounding; ``text``, ``gone`` and ``new`` are told and decide nothing.
Weight = Literal["bits", "verdict", "moved", "rounding", "text", "gone", "new"]


@dataclass(frozen=True)
class Difference:
    """Two values of one name; of a list those that are farthest apart, at a `place`. None stands for no value."""

    item: str
    before: float | str | None
    after: float | str | None
    weight: Weight
    place: int | None = None
    why: str = ""

    @property
    def fails(self) -> bool:
        """Whether it must not be, or lacks its reason."""
        return self.weight in ("bits", "verdict") or (self.weight == "moved" and not self.why)

    @property
    def text(self) -> str:
        """Name and both values."""
        before, after = (
            "none" if each is None else each if isinstance(each, str) else f"{each:.6g}"
            for each in (self.before, self.after)
        )
        if before == after:  # they differ beyond what is written
            before, after = f"{self.before!r}", f"{self.after!r}"
        return f"{self.item}{'' if self.place is None else f'[{self.place}]'}: {before} → {after}"


# Differences ------------------------------------------------------------------------------------------
def differences(
    design: str, before: Mapping[str, Any], after: Mapping[str, Any], reasons: Sequence[Reason] = REASONS
) -> list[Difference]:
    """All that differs between two trees for a design, with the reasons that are given for it."""
    found = [*_verdicts(before, after), *_of_groups(before["groups"], after["groups"])]
    if before.get("export") and after.get("export"):
        found += _of_exports(before["export"], after["export"])
    return [_reasoned(design, each, reasons) for each in found]


def _reasoned(design: str, found: Difference, reasons: Sequence[Reason]) -> Difference:
    if found.weight != "moved":
        return found
    said = [each.why for each in reasons if each.covers(design, found.item, found.before, found.after)]
    return replace(found, why="; ".join(dict.fromkeys(said)))


def _verdicts(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    yield from _verdict("all requirements", before["met"], after["met"])
    for one, other in paired(before["requirements"], after["requirements"]):
        line = one or other or {}
        name = f"{line['what']} ({line['where']})"
        if one is None or other is None:
            found = [None if side is None else side["found"] for side in (one, other)]
            yield Difference(f"{name}, row", *found, weight="moved")
            continue
        yield from _verdict(name, one["met"], other["met"])
        for key in ("found", "limit", "unit", "joint", "where"):
            yield from value_difference(f"{name}, {key}", one[key], other[key])


def _verdict(name: str, before: bool, after: bool) -> Iterator[Difference]:
    if before is not after:
        words = {True: "met", False: "not met"}
        yield Difference(f"{name}, verdict", words[before], words[after], "verdict")


def paired(
    before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]]:
    """Rows of one requirement: first those of the same run or loop, then of the same unit, then in their order."""
    ones, others = list(before), list(after)
    for keys in (("what", "where", "unit"), ("what", "unit"), ("what",)):
        for one in list(ones):
            alike = [other for other in others if all(one[key] == other[key] for key in keys)]
            if alike:
                ones.remove(one)
                others.remove(alike[0])
                yield one, alike[0]
    yield from ((one, None) for one in ones)
    yield from ((None, other) for other in others)


def _of_groups(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    for group, values in before.items():
        others = after.get(group, {})
        for name in (each for each in values if each in others):
            weight: Weight = "bits" if group in BITS else "moved"
            yield from value_difference(f"{group}: {name}", values[name], others[name], weight)
        new = {name: value for name, value in others.items() if name not in values}
        for name in (each for each in values if each not in others):
            # A number under another name is the same number.
            named = [each for each, value in new.items() if value == values[name]]
            gone: Weight = "bits" if group in BITS else "gone"
            yield Difference(
                f"{group}: {name}", _brief(values[name]), f"named {named[0]}" if named else None, gone
            )
        for name in new:
            yield Difference(f"{group}: {name}", None, _brief(new[name]), "new")


def _of_exports(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    files, others = before["digests"], after["digests"]
    for name in dict.fromkeys((*files, *others)):
        one, other = (each[name][:DIGEST] if name in each else None for each in (files, others))
        if one != other:
            yield Difference(f"C: {name}", one, other, "moved" if name.endswith(CODE) else "text")
    vector, others = before["vector"], after["vector"]
    for name in dict.fromkeys((*vector, *others)):
        if name in vector and name in others:
            yield from value_difference(f"C: {name}", vector[name], others[name])
        else:
            yield Difference(f"C: {name}", _brief(vector.get(name)), _brief(others.get(name)), "moved")
    if after["answers as recorded"] is None:
        yield Difference("C: answers", None, "not run, for want of a compiler", "text")
    elif not after["answers as recorded"]:
        yield Difference("C: answers", "as recorded", "other ones", "verdict")


def value_difference(name: str, before: Any, after: Any, weight: Weight = "moved") -> Iterator[Difference]:
    """The difference of two values of one name, if there is one: texts, truths, numbers or lists of numbers."""
    if before == after:
        return
    texts = [isinstance(value, str) for value in (before, after)]
    if any(texts) or isinstance(before, bool) or isinstance(after, bool):
        decides = weight == "bits" or not all(texts)
        yield Difference(name, _brief(before), _brief(after), weight if decides else "text")
        return
    one, other = np.atleast_1d(before), np.atleast_1d(after)
    if one.shape != other.shape:
        yield Difference(name, f"{one.size} numbers", f"{other.size} numbers", weight)
        return
    differ = ~((one == other) | (np.isnan(one) & np.isnan(other)))
    if not differ.any():
        return
    with np.errstate(invalid="ignore"):
        apart = np.where(differ, np.abs(one - other), 0.0)
    apart = np.where(np.isfinite(apart) | ~differ, apart, np.inf)
    place = int(np.argmax(apart))
    both = np.abs([one, other])
    largest = np.max(both, where=np.isfinite(both), initial=0.0)
    near: Weight = "rounding" if apart[place] <= ROUNDING * largest and weight != "bits" else weight
    listed = place if one.size > 1 else None
    yield Difference(name, float(one[place]), float(other[place]), near, listed)


def _brief(value: Any) -> float | str | None:
    """A value as it is told: the beginning of a text, the size of a list."""
    if isinstance(value, list):
        return f"{len(value)} numbers"
    if isinstance(value, str):
        return value if len(value) <= LONG else f"{value[:LONG]}…"
    return str(value) if isinstance(value, bool) else value


def help_diff(before: Mapping[str, str], after: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Commands whose help differs, with the lines that do; of one that came or went, all lines."""
    for command in dict.fromkeys((*before, *after)):
        one, other = (each.get(command, "").splitlines() for each in (before, after))
        if one != other:
            lines = difflib.unified_diff(one, other, "before", "after", lineterm="", n=0)
            yield command, "\n".join(lines)


# Table ------------------------------------------------------------------------------------------------
def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A row for the designs of one outcome: law, verdicts, numbers that moved with their reasons, others."""
    outcomes: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        outcomes.setdefault(_outcome(row), []).append(row["design"])
    lines = [
        "| designs | law, filter, γ | verdicts | numbers that moved, and why | others |",
        "|---|---|---|---|---|",
    ]
    return "\n".join(
        [*lines, *(f"| {'; '.join(each)} | {' | '.join(cells)} |" for cells, each in outcomes.items())]
    )


def _outcome(row: Mapping[str, Any]) -> tuple[str, ...]:
    found = [Difference(**each) for each in row["differences"]]
    bits = sum(each.weight == "bits" for each in found)
    verdicts = [each.text for each in found if each.weight == "verdict"]
    moved: dict[str, list[str]] = {}
    for each in found:
        if each.weight == "moved":
            moved.setdefault(each.why or "without a reason", []).append(each.text)
    others = [f"{row['told'][weight]} {words}" for weight, words in TOLD.items() if weight in row["told"]]
    return (
        f"{bits} moved" if bits else "equal to the bit",
        "; ".join(verdicts) or "equal",
        "; ".join(f"{len(texts)}, {why}: {texts[0]}" for why, texts in moved.items()) or "none",
        ", ".join(others) or "equal",
    )


#: What is told of differences that decide nothing.
TOLD = {"rounding": "by rounding", "text": "texts", "gone": "no longer there", "new": "new"}


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """One line on all designs."""
    found = [Difference(**each) for row in rows for each in row["differences"]]
    count = Counter(each.weight for each in found)
    bare = sum(each.fails for each in found if each.weight == "moved")
    exports = sum(bool(row["exported"]) for row in rows)
    numbers = sum(row["numbers"] for row in rows)
    return (
        f"{len(rows)} designs, {exports} exports, {numbers:,} numbers: {count['bits']} of laws, filters and γ moved, "
        f"{count['verdict']} verdicts changed, {count['moved']} other numbers moved, {bare} of them without a reason"
    )


def row_of(
    design: str, before: Mapping[str, Any], after: Mapping[str, Any], found: Sequence[Difference]
) -> dict[str, Any]:
    """What is kept of a design: differences that decide, and the number of the others."""
    told = Counter(each.weight for each in found if each.weight in TOLD)
    return {
        "design": design,
        "exported": bool(before.get("export") and after.get("export")),
        "numbers": _count(before),
        "differences": [asdict(each) for each in found if each.weight not in TOLD],
        "told": dict(told),
    }


def _count(read: Mapping[str, Any]) -> int:
    """Numbers that are compared of a design."""
    groups = [*read["groups"].values(), (read.get("export") or {}).get("vector", {})]
    values = [value for group in groups for value in group.values() if not isinstance(value, str | bool)]
    return 2 * len(read["requirements"]) + sum(np.size(value) for value in values)
