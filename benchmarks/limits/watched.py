"""The tables of docs/limits.md about encoders, frames and what would stop an arm."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.limits.arms import ARMS, ENCODED
from benchmarks.limits.cells import MISSING, cells, head, limit_text, milli
from benchmarks.limits.rows import PRODUCT, PUSHED, kept
from benchmarks.limits.rule import missed, said
from benchmarks.limits.trials import ENCODERS, FRAMES, TRIALS, Trial
from flexhinf.loop.controller.stop import Stop

__all__ = ["TABLES", "encoded"]

#: What a brake looks like to who is not told of it: a drive without torque, and an encoder that stands.
BRAKED = Stop.INCONSISTENT | Stop.STUCK

#: Why a run is ended, by what happens and the reason.
PUSH = "a push"
ALARM = "**false alarm**"
CARRIED = f"{ALARM}: what is pushed slows down by less than a tenth in 20 ms"
DAMPED = f"{ALARM}: an impact, or what is let go, swings until inputs have damped it"
WHY = {
    ("brake", Stop.INCONSISTENT): "the drive gives nothing, and nobody says so",
    ("power", Stop.INCONSISTENT): "the drive gives half of what the file says",
    ("power", Stop.OPPOSED): "the same, where the weight needs more than that",
    ("off", Stop.BAD_START): "the arm is not where the controller begins",
    ("stop", Stop.OPPOSED): CARRIED,
    ("stop", Stop.OSCILLATING): DAMPED,
    ("push", Stop.TOO_FAST): "the push itself is faster than a joint may ever be",
    ("push", Stop.SENSOR_LOST): "readings that change faster than a joint may are not believed",
    ("push", Stop.RUNAWAY): "a pushed joint leaves its command by itself, as one that runs away",
    ("push", Stop.OPPOSED): CARRIED,
    ("push", Stop.OSCILLATING): DAMPED,
}


class Ended(NamedTuple):
    """A run that a protective stop would end: of which arm, in what, when after its cause, s, why."""

    arm: str
    what: str
    after: float
    reasons: Stop
    why: str


def stops(folder: Path) -> str:
    """Runs that the protective stop would end, by what happens and the reason."""
    runs = [*_ended(folder)]
    found = defaultdict[tuple[str, Stop, str], list[Ended]](list)
    for run in runs:
        if run.reasons:
            found[run.what, run.reasons, run.why].append(run)
    lines = head(("what happens", "the stop says", "runs: after", "why"))
    for (what, reasons, why), ended in found.items():
        where = "; ".join(_listed(name, ended) for name in ARMS if any(run.arm == name for run in ended))
        lines.append(cells([what, _reasons(reasons), where, why]))
    both = [[run for run in runs if (run.what == PUSH) == pushed] for pushed in (False, True)]
    counts = [(sum(bool(run.reasons) for run in some), len(some)) for some in both]
    text = "{} of {} runs of trials are ended, and {} of {} pushes from which the law returns."
    return "\n".join([*lines, "", text.format(*counts[0], *counts[1])])


def _listed(name: str, ended: list[Ended]) -> str:
    times = [run.after for run in ended if run.arm == name]
    first, last = milli(min(times)), milli(max(times))
    return f"{name} {len(times)}: {first if first == last else f'{first} to {last}'} ms"


def _ended(folder: Path) -> Iterator[Ended]:
    """Every run of which the stop was recorded; those that it does not end have no reasons."""
    for name in ARMS:
        rows = kept(folder, name)
        happens = [
            (trial.title, kinds_of(trial), rows.get(row, {}).get(PRODUCT, {}).get("stops", []))
            for row, trial in TRIALS.items()
        ]
        pushes = rows.get(PUSHED, {}).get(PRODUCT, {"pushes": []})["pushes"]
        happens.append((PUSH, ["push"], [stop for push in pushes for stop in push.get("stops", [])]))
        for what, kinds, stops in happens:
            for stop in stops:
                after, reasons = (0.0, Stop(0)) if stop is None else (stop[0], Stop(stop[1]))
                yield Ended(name, what, after, reasons, _why(kinds, reasons))


def kinds_of(trial: Trial) -> list[str]:
    """What happens in a trial."""
    kinds = [kind for kind in ("brake", "stop", "off") if getattr(trial, kind)]
    return kinds + ["power"] * (trial.power < 1.0)


def _why(kinds: Sequence[str], reasons: Stop) -> str:
    """Why, of each reason; a false alarm where nothing in the trial is one."""
    found = [next((WHY[kind, one] for kind in kinds if (kind, one) in WHY), ALARM) for one in reasons]
    return "; ".join(dict.fromkeys(found))


def _reasons(reasons: Stop) -> str:
    return ", ".join(str(one.name).lower().replace("_", " ") for one in reasons) or "nothing"


def encoders(folder: Path) -> str:
    """Encoders without noise: a line for each arm and trial."""
    lines = head((
        "arm", "encoders", "flexhinf: beyond, speed, back", "PD: beyond, speed, back", "frames missing, ms", "stop",
        "rule",
    ))  # fmt: skip
    for name in ENCODED:
        rows = kept(folder, name)
        for key, trial in ENCODERS.items():
            row = rows.get(key, {})
            if PRODUCT in row:
                own = row[PRODUCT]
                pd = limit_text(row["pd"]) if "pd" in row else MISSING
                verdict = said(encoded(trial, row)) if "pd" in row else MISSING
                lines.append(
                    cells(
                        [name, trial.title, limit_text(own), pd, str(own["unseen"]), _stopped(own), verdict]
                    )
                )
    return "\n".join(lines)


def encoded(trial: Trial, row: dict[str, dict[str, Any]]) -> list[str]:
    """Parts that are missed of the rule of encoders: that of limits; nothing stops the arm but what a brake looks like;
    readings are believed, and frames are missing no longer than they are repeated."""
    own = row[PRODUCT]
    allowed = BRAKED if trial.brake else Stop(0)
    stopped = any(stop is not None and Stop(stop[1]) & ~allowed for stop in own["stops"])
    unseen = own["rejected"] > 0 or own["unseen"] > (trial.half_rate == "all")
    return [*(["lost"] if own["lost"] else missed(row)), *["stop"] * stopped, *["missing"] * unseen]


def _stopped(row: dict[str, Any]) -> str:
    ended = [(after, Stop(bits)) for after, bits in filter(None, row["stops"])]
    return "; ".join(f"{milli(after)} ms: {_reasons(reasons)}" for after, reasons in ended[:1]) or "none"


def frames(folder: Path) -> str:
    """Frames that are repeated in mid-move, and that are missing: how far links go off their command."""
    lines = head(("arm", "for", "repeated: off, missing", "as NaN: off", "PD, repeated: off", "stop"))
    for name in ENCODED:
        rows = kept(folder, name)
        for key, trial in FRAMES.items():
            row = rows.get(key, {})
            if not trial.missing and PRODUCT in row:
                nan = rows.get(key.replace("repeated", "missing"), {}).get(PRODUCT)
                own = row[PRODUCT]
                told = f"{_away(own)}, {own['unseen']} ms"
                lines.append(
                    cells([name, trial.title, told, _away(nan), _away(row.get("pd")), _stopped(own)])
                )
    return "\n".join(lines)


def _away(row: dict[str, Any] | None) -> str:
    if row is None:
        return MISSING
    return "lost" if row["lost"] else f"{milli(row['away'])} mrad"


TABLES: dict[str, Callable[[Path], str]] = {"stops": stops, "encoders": encoders, "frames": frames}
