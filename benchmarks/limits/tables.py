"""The tables of docs/limits.md, of the rows that are kept."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.limits.arms import ARMS
from benchmarks.limits.cells import MISSING, cells, digits, head, limit_text, milli, short_text
from benchmarks.limits.laws import LAWS
from benchmarks.limits.pushes import TIMES as FARTHER
from benchmarks.limits.rows import MET, NONE, PRODUCT, PUSHED, kept
from benchmarks.limits.rule import LEAST, judged
from benchmarks.limits.trials import CURVED, TRIALS
from benchmarks.limits.watched import TABLES as WATCHED
from flexhinf import Status

__all__ = ["TABLES", "beyond_limits", "returns"]

#: Laws that a row needs for a comparison.
BOTH = {PRODUCT, "pd"}
#: Numbers of the first measurement, brakes for 0.5 s: rad beyond, times the speed limit.
BEFORE = {"beltscara": (3.23, 2.3), "iiwa": (0.87, 5.2), "pallet": (0.44, None)}


def met(folder: Path) -> str:
    """Thirteen arms: by which command they are met, and what 40 moves in the simulator say."""
    lines = head(
        ("arm", "met", "the first command missed", "40 moves: worst, of what the design allows", "beyond")
    )
    counts = [0, 0, 0]
    for name, source in ARMS.items():
        rows = kept(folder, name)
        design = rows.get("design")
        if design is None:
            lines.append(cells([f"{name}: {source.about}", MISSING, "", "", ""]))
            continue
        counts[design["command"] - 1 if design["met"] else 2] += 1
        how = "no"
        if design["met"]:
            how = "at once" if design["command"] == 1 else f"with `{shlex.join(design['more'])}`"
        run = rows.get(MET, {}).get(PRODUCT)
        lines.append(cells([
            f"{name}: {source.about}", how, ", ".join(design["missed"]) or "nothing",
            *((MISSING, "") if run is None else _judged(design["limits"], run)),
        ]))  # fmt: skip
    said = f"{counts[0]} met at the first command, {counts[1]} by the command that it names, {counts[2]} not met."
    return "\n".join([*lines, "", said])


#: What a design allows and the simulator measures, with the factor and unit of a reader.
MEASURED = {
    "remaining error": ("remains", 1e3, "mrad"), "tracking error": ("tracking", 1e3, "mrad"),
    "motion the wrong way": ("wrong way", 1.0, "%"), "ripple of the motors": ("ripple", 1.0, "%"),
}  # fmt: skip


def beyond_limits(limits: dict[str, float], run: dict[str, Any]) -> int:
    """Moves beyond one of the limits, those that were lost or not run included."""
    whole = [all(run[key][k] <= limits[key] for key in MEASURED if key in limits) for k in range(run["run"])]
    return run["moves"] - sum(whole)


def _judged(limits: dict[str, float], run: dict[str, Any]) -> tuple[str, str]:
    texts = [
        f"{what} {digits(factor * max(run[key]))} of {digits(factor * limits[key])} {unit}"
        for key, (what, factor, unit) in MEASURED.items()
        if key in limits and run["run"]
    ]
    return ", ".join(texts), f"{beyond_limits(limits, run)} of {run['moves']}"


def rest(folder: Path) -> str:
    """The 40 moves with each law: how many arrive within what the design allows, and the worst that remains."""
    lines = head(("arm", "within", *LAWS.values()))
    for name in ARMS:
        rows = kept(folder, name)
        runs = rows.get(MET, {})
        if PRODUCT in runs and len(runs) > 1:
            most = rows["design"]["limits"]["remaining error"]
            texts = [_arrived(runs[law], most) if law in runs else _missing(rows, law) for law in LAWS]
            lines.append(cells([name, f"{milli(most)} mrad", *texts]))
    return "\n".join(lines)


def _arrived(run: dict[str, Any], most: float) -> str:
    errors = run["remaining error"]
    worst = (
        "" if not errors else f", {milli(max(errors))} mrad" if not run["lost"] else f", {run['lost']} lost"
    )
    return f"{sum(error <= most for error in errors)} of {run['moves']}{worst}"


def limits(folder: Path) -> str:
    """What happens at the limits: a line for each arm and trial."""
    lines = head((
        "arm", "trial", *(f"{LAWS[law]}: beyond, speed, back" for law in LAWS), "status of flexhinf", "rule",
    ))  # fmt: skip
    for name in ARMS:
        rows = kept(folder, name)
        for trial, about in TRIALS.items():
            row = rows.get(trial)
            if row and PRODUCT in row:
                texts = [limit_text(row[law]) if law in row else _missing(rows, law) for law in LAWS]
                lines.append(cells([name, about.title, *texts, _status(row[PRODUCT]["status"]), judged(row)]))
    return "\n".join(lines)


def pushes(folder: Path) -> str:
    """Arms that are pushed: from how many pushes the law returns, and the controller, and by how much it keeps the
    rule."""
    lines = head(
        (
            "arm",
            "pushes",
            "the law returns",
            "the controller too",
            "furthest, of the law's",
            "latest, of its time",
            "rule",
        )
    )
    for name in ARMS:
        found = kept(folder, name).get(PUSHED, {}).get(PRODUCT)
        if found is not None:
            runs = [one for one in found["pushes"] if "own" in one]
            back = [one for one in runs if one["own"][1] is not None]
            far = max((one["own"][0] / one["law"][0] for one in runs), default=0.0)
            late = max((one["own"][1] / one["allowed"] for one in back), default=0.0)
            counts = len(found["pushes"]), len(runs), len(back)
            missed = sum(not returns(one) for one in runs)
            verdict = f"missed: {missed}" if missed else "kept"
            lines.append(cells([name, *map(str, counts), f"{far:.2f}", f"{late:.2f}", verdict]))
    return "\n".join(lines)


def returns(run: dict[str, Any]) -> bool:
    """Whether the rule of pushes is kept after one from which the law returns."""
    (far, back), (most, _) = run["own"], run["law"]
    return back is not None and back <= run["allowed"] and far <= FARTHER * most


def before(folder: Path) -> str:
    """Brakes for half a second: as it was before, and now."""
    lines = head(("arm", "before: beyond, speed", "now: beyond, speed", "PD now"))
    for name, (far, fast) in BEFORE.items():
        row = kept(folder, name).get("brake-0.5", {})
        speed = "" if fast is None else f", {fast:g}"
        now = [short_text(row[law]) if law in row else MISSING for law in (PRODUCT, "pd")]
        lines.append(cells([name, f"{far:g} rad{speed}", *now]))
    return "\n".join(lines)


def tracking(folder: Path) -> str:
    """Paths at full speed: peak and root mean square, nominal and corners."""
    lines = head(("arm", "path", *(f"{LAWS[law]}: nominal peak, rms; corners" for law in LAWS)))
    for name in ARMS:
        rows = kept(folder, name)
        for path, title in CURVED.items():
            row = rows.get(path)
            if row and PRODUCT in row:
                lines.append(
                    cells(
                        [
                            name,
                            title,
                            *(_followed(row[law]) if law in row else _missing(rows, law) for law in LAWS),
                        ]
                    )
                )
    return "\n".join(lines)


def rivals(folder: Path) -> str:
    """What each rival was tuned to."""
    lines = head(("arm", *(f"{LAWS[law]}: bandwidth, damping, ripple" for law in LAWS if law != PRODUCT)))
    for name in ARMS:
        tuned = kept(folder, name).get("tuned", {})
        if tuned:
            lines.append(
                cells(
                    [
                        name,
                        *(_tuned(tuned[law]) if law in tuned else MISSING for law in LAWS if law != PRODUCT),
                    ]
                )
            )
    return "\n".join(lines)


def short(folder: Path) -> str:
    """What the tables say: where PD is better, what misses the rule, which "met" is not true."""
    every = {name: kept(folder, name) for name in ARMS}
    lines = [*head(("what", "where"))]
    for what, found in (
        ("PD goes less far beyond, by 2 mrad or more", _less_far), ("PD follows more exactly", _more_exactly),
        ("PD arrives more often", _more_often), ("PD's worst goal is nearer", _nearer),
    ):  # fmt: skip
        where = [text for name, rows in every.items() for text in found(name, rows)]
        lines.append(cells([what, _listed(where, "in no row")]))
    lines.append(cells(["PD is back sooner", _sooner([*every.values()])]))
    verdicts = [
        (f"{name}, {about.title}", judged(rows[trial]))
        for name, rows in every.items()
        for trial, about in TRIALS.items()
        if {*rows.get(trial, {})} >= BOTH
    ]
    missed = [f"{where} ({said})" for where, said in verdicts if said != "kept"]
    kept_in = f"{len(verdicts) - len(missed)} of {len(verdicts)} rows"
    lines.append(cells(["flexhinf keeps the rule of limits", f"{kept_in}; not in: {_listed(missed)}"]))
    runs = [
        (name, one)
        for name, rows in every.items()
        for one in rows.get(PUSHED, {}).get(PRODUCT, {"pushes": []})["pushes"]
        if "own" in one
    ]
    gone = [f"{name}, {one['where']}, {one['speeds']}" for name, one in runs if not returns(one)]
    text = f"{len(runs) - len(gone)} of {len(runs)} pushes; not from: {_listed(gone)}"
    lines.append(cells(["flexhinf returns from a push as its law does", text]))
    run = {
        name: (beyond_limits(rows["design"]["limits"], rows[MET][PRODUCT]), rows[MET][PRODUCT]["moves"])
        for name, rows in every.items()
        if rows.get("design", {}).get("met") and PRODUCT in rows.get(MET, {})
    }
    false = [f"`{name}` ({beyond} of {moves} moves)" for name, (beyond, moves) in run.items() if beyond]
    true = f"{len(run) - len(false)} of {len(run)} met arms whose moves were run"
    true += f"; not of: {_listed(false)}" * bool(false)
    return "\n".join([*lines, cells(['"met" is true', true])])


def _less_far(name: str, rows: dict[str, Any]) -> list[str]:
    """Trials in which PD goes beyond by at least 2 mrad less."""
    found = []
    for trial, about in TRIALS.items():
        if {*(row := rows.get(trial, {}))} >= BOTH:
            own, pd = (row[law]["beyond"] for law in (PRODUCT, "pd"))
            if pd is not None and (own is None or pd < own - LEAST):
                found.append(f"{name}, {about.title} ({_against(pd, own)})")
    return found


def _more_exactly(name: str, rows: dict[str, Any]) -> list[str]:
    """Paths along which PD's largest error is smaller."""
    found = []
    for path, title in CURVED.items():
        if {*(row := rows.get(path, {}))} >= BOTH:
            for who in ("nominal", "corners"):
                own, pd = (row[law][who]["peak"] for law in (PRODUCT, "pd"))
                if pd is not None and (own is None or pd < own):
                    found.append(f"{name}, {title}, {who} ({_against(pd, own)})")
    return found


def _more_often(name: str, rows: dict[str, Any]) -> list[str]:
    """The arm, where more of PD's moves end within what the design allows."""
    if not {*(runs := rows.get(MET, {}))} >= BOTH:
        return []
    most = rows["design"]["limits"]["remaining error"]
    own, pd = (sum(error <= most for error in runs[law]["remaining error"]) for law in (PRODUCT, "pd"))
    return [f"{name} ({pd} moves, flexhinf {own})"] if pd > own else []


def _nearer(name: str, rows: dict[str, Any]) -> list[str]:
    """The arm, where the worst that remains of PD's moves is smaller."""
    if not {*(runs := rows.get(MET, {}))} >= BOTH or runs["pd"]["lost"]:
        return []
    own, pd = (max(runs[law]["remaining error"], default=None) for law in (PRODUCT, "pd"))
    return [f"{name} ({_against(pd, own)})"] if pd is not None and (own is None or pd < own) else []


def _sooner(every: Sequence[dict[str, Any]]) -> str:
    """In how many rows all joints of PD are back sooner, and in which trial most often."""
    both = {trial: [rows[trial] for rows in every if {*rows.get(trial, {})} >= BOTH] for trial in TRIALS}
    won = {trial: sum(_back(row["pd"]) < _back(row[PRODUCT]) for row in rows) for trial, rows in both.items()}
    counted = f"{sum(won.values())} of {sum(map(len, both.values()))} rows"
    most = max(won, key=lambda trial: won[trial])
    return counted + f", most often: {TRIALS[most].title} ({won[most]} of {len(both[most])})" * bool(
        won[most]
    )


def _back(row: dict[str, Any]) -> float:
    return math.inf if row["back"] is None else row["back"]


def _against(pd: float, own: float | None) -> str:
    return f"{milli(pd)} mrad, flexhinf {'lost' if own is None else milli(own)}"


def _missing(rows: dict[str, Any], law: str) -> str:
    """Why a law has no row."""
    return NONE if rows.get("tuned", {}).get(law, {}) is None else MISSING


def _listed(texts: list[str], none: str = "none") -> str:
    return "; ".join(texts) or none


TABLES: dict[str, Callable[[Path], str]] = {
    "short": short, "met": met, "rest": rest, "limits": limits, "before": before, "tracking": tracking,
    "rivals": rivals, "pushes": pushes, **WATCHED,
}  # fmt: skip


def _tuned(one: dict[str, Any] | None) -> str:
    return (
        NONE
        if one is None
        else f"{digits(one['bandwidth'])} rad/s, {one['damping']:.2f}, {digits(one['ripple'])} %"
    )


def _followed(row: dict[str, Any]) -> str:
    nominal, corners = ((one["peak"], one["rms"]) for one in (row["nominal"], row["corners"]))
    return "; ".join(
        "lost" if peak is None or rms is None else f"{milli(peak)}, {milli(rms)}" for peak, rms in (nominal, corners)
    ) + " mrad"  # fmt: skip


def _status(bits: int) -> str:
    names = [str(one.name).lower().replace("_", " ") for one in Status if one & bits]
    return ", ".join(names) or "none"
