"""Tables of faults: how many runs ended how, and the worst of each."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.faults.arms import ARMS
from benchmarks.faults.kinds import FAULTS, GROUPS, HARMLESS, MOVES, MOVES_OF_A_RUN, OUTSIDE, TRIPS
from benchmarks.faults.verdict import FAILURES, VERDICTS, judged, judged_harmless

__all__ = ["KEPT", "TABLES", "failures", "summary", "trips"]

#: What the docs show.
KEPT = Path(__file__).resolve().parent / "results.json"


def failures(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows of faults that fail the rule."""
    return [row for row in rows if row["fault"] in FAULTS and judged(row) in FAILURES]


def trips(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows of what is harmless, that something stopped."""
    return [row for row in rows if row["fault"] not in FAULTS and not judged_harmless(row)]


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """By arm and fault: how many runs ended how, and the worst numbers of those that were noticed."""
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        own = found.setdefault(row["arm"], {}).setdefault(row["fault"], {"runs": 0})
        verdict = judged(row) if row["fault"] in FAULTS else "kept" if judged_harmless(row) else "tripped"
        own["runs"] += 1
        if why := row["hidden"] or row["slow"]:
            own["why"] = why
        own[verdict] = own.get(verdict, 0) + 1
        if row["noticed"] and not row["early"]:
            own["category"] = sorted({*own.get("category", []), row["category"]})
            ratio = row["furthest"] / max(row["ideal"], 1e-3)
            wrong, way = row["wrong_at_notice"], row["furthest"]
            braked = row["category"] == 0
            worst = {
                "when": row["when"],
                "wrong": wrong,
                "furthest": way,
                "ratio": ratio,
                "fell": row["fell"],
                **({"rested": row["rested"]} if braked else {}),
            }
            for key, value in worst.items():
                own[key] = max(own.get(key, 0.0), float(f"{value:.4g}"))
    return found


def _cells(texts: Sequence[str]) -> str:
    return f"| {' | '.join(texts)} |"


def _head(texts: Sequence[str]) -> list[str]:
    return [_cells(texts), f"|{'---|' * len(texts)}"]


def kept(file: Path = KEPT) -> dict[str, Any]:
    """The results that the docs show."""
    return json.loads(file.read_text(encoding="utf-8"))


def by_fault(results: Mapping[str, Any]) -> str:
    """A line for each fault: of each arm how many runs were kept, harmless, and failed; the worst of all arms."""
    arms = results["arms"]
    lines = _head(
        (
            "fault",
            *arms,
            "noticed after",
            "wrong motion by then",
            "furthest, of the ideal stop",
            "falls",
            "category",
        )
    )
    for name in FAULTS:
        every = [arms[arm][name] for arm in arms if name in arms[arm]]
        if every:
            lines.append(_cells([name, *(_ended(arms[arm].get(name)) for arm in arms), *_worst(every)]))
    return "\n".join([*lines, "", _counted(arms)])


#: Numbers of runs that were noticed, with how each is written.
WHEN, WRONG, WAY = ("when", "{:.3g} ms"), ("wrong", "{:.2g} rad"), ("furthest", "{:.2g} rad")


def _most(found: Sequence[Mapping[str, Any]], key: str, text: str) -> str:
    """The largest number of some arms, "" where none has it; times in ms are kept in s."""
    scale = 1e3 if text.endswith(" ms") else 1.0
    numbers = [scale * one[key] for one in found if key in one]
    return text.format(max(numbers)) if numbers else ""


def _worst(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of the arms' runs that were noticed."""
    if not any("when" in one for one in found):
        return [""] * 5
    when, wrong, way, ratio = (_most(found, *each) for each in (WHEN, WRONG, WAY, ("ratio", "{:.3g}")))
    fell = _most([one for one in found if one.get("fell")], "fell", "{:.2g} rad")
    category = sorted({each for one in found for each in one.get("category", ())})
    return [when, wrong, f"{way}, {ratio}", fell, ", ".join(map(str, category))]


def tried(results: Mapping[str, Any]) -> str:
    """A line for each fault, the worst of all arms, for ``safety.md``."""
    arms = results["arms"]
    lines = _head(
        (
            "fault",
            "noticed after",
            "by then",
            "rests after",
            "furthest after the notice",
            "not as it should be, or not noticed",
        )
    )
    for name, fault in FAULTS.items():
        every = [arms[arm][name] for arm in arms if name in arms[arm]]
        if not every:
            continue
        quiet = [
            f"{sum(one.get(end, 0) for one in every)} {end}"
            for end in VERDICTS
            if end != "kept" and any(end in one for one in every)
        ]
        cells = [_most(every, *each) for each in (WHEN, WRONG, ("rested", "{:.2g} s"), WAY)]
        lines.append(_cells([f"{name}: {fault.about}", *cells, ", ".join(quiet)]))
    return "\n".join(lines)


def _ended(one: Mapping[str, Any] | None) -> str:
    """Of an arm's runs of a fault."""
    if one is None:
        return ""
    bad = ", ".join(f"{one[name]} {name}" for name in FAILURES if name in one)
    good = [f"{one[name]} {name}" for name in VERDICTS if name in one and name not in FAILURES]
    return ", ".join([*good, *([f"**{bad}**"] if bad else [])])


def _counted(arms: Mapping[str, Any]) -> str:
    counts = _verdicts(arms, FAULTS)
    return (
        f"{counts.total()} runs: "
        + ", ".join(f"{counts[name]} {name}" for name in VERDICTS if counts[name])
        + "."
    )


def _verdicts(arms: Mapping[str, Any], names: Collection[str]) -> Counter[str]:
    """How many runs of these faults ended how."""
    counts = Counter[str]()
    for faults in arms.values():
        for name in set(names) & set(faults):
            counts.update({key: faults[name][key] for key in VERDICTS if key in faults[name]})
    return counts


def by_group(results: Mapping[str, Any]) -> str:
    """A line for each group of faults: how many runs ended how."""
    arms = results["arms"]
    ends = [name for name in VERDICTS if _verdicts(arms, FAULTS)[name]]
    lines = _head(("faults of", "kinds and sides", "runs", *ends))
    for title, faults in GROUPS.items():
        counts = _verdicts(arms, [fault.name for fault in faults])
        lines.append(
            _cells(
                [title, str(len(faults)), str(counts.total()), *(str(counts[name] or "") for name in ends)]
            )
        )
    return "\n".join([*lines, "", *(f"- {name}: {VERDICTS[name]}" for name in ends)])


def hidden(results: Mapping[str, Any]) -> str:
    """What the sensors of an arm cannot show or show late, why, and what does; faults of one reason share a row."""
    arms = results["arms"]
    found: dict[tuple[str, str], list[str]] = {}
    for name in FAULTS:
        for arm in arms:
            if why := arms[arm].get(name, {}).get("why"):
                found.setdefault((why, name), []).append(arm)
    rows: dict[tuple[str, str], list[str]] = {}
    for (why, name), those in found.items():
        rows.setdefault((why, ", ".join(those)), []).append(name)
    lines = _head(("why sensors cannot show it, or show it late", "arms", "faults", "what does"))
    lines += [_cells([why, those, "; ".join(names), OUTSIDE[why]]) for (why, those), names in rows.items()]
    return "\n".join(lines)


def harmless(results: Mapping[str, Any]) -> str:
    """What may not stop an arm: runs, how many were stopped, and why."""
    arms = results["arms"]
    lines = _head(("event", *arms, "why some are stopped"))
    for name in (*HARMLESS, MOVES.name):
        about = f"{name}, {MOVES_OF_A_RUN} a run" if name == MOVES.name else name
        found = [arms[arm].get(name) for arm in arms]
        cells = ["" if one is None else f"{one.get('tripped', 0)} of {one['runs']}" for one in found]
        stopped = any(one and one.get("tripped") for one in found)
        lines.append(_cells([about, *cells, TRIPS.get(name, "") if stopped else ""]))
    return "\n".join(lines)


def arms(results: Mapping[str, Any]) -> str:
    """The arms, and by which command the results were made."""
    lines = [f"- `{name}`: {ARMS[name].about}" for name in results["arms"] if name in ARMS]
    return "\n".join([*lines, "", f"Made by `{results['command']}`."])


TABLES: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "arms": arms,
    "groups": by_group,
    "hidden": hidden,
    "harmless": harmless,
    "tried": tried,
    "faults": by_fault,
}
