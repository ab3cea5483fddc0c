"""What an assessor asks of exported C, as far as the exporter knows it: faults, times, tests, rules, version."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from flexhinf import __version__
from flexhinf.export.contract import CODES
from flexhinf.export.controller_c import MISSING_LIMIT, STATUS, ControllerCode
from flexhinf.export.follow import follower_of
from flexhinf.export.protection import fallen
from flexhinf.export.recording import Recording
from flexhinf.export.rendering import markdown, of_file
from flexhinf.loop import Status
from flexhinf.loop.controller.memory import SPACING
from flexhinf.stops import STOPS

#: After how many samples a fault has its code; others have it at once.
AT_ONCE = "in the same sample"

#: Who acts on a code, and who on a bit.
CALLER, CONTROLLER = "your program", "the controller; your program looks"

#: Time for which an arm falls, s.
FALLS = 0.1

#: Which event of a supervision sets a bit.
EVENTS = {
    Status.OUTSIDE_WORKSPACE: "workspace",
    Status.LIMIT_CYCLE: "limit_cycle",
    Status.SATURATION: "saturation",
    Status.FOLLOWING_ERROR: "following",
    Status.BLOCKED: "blocked",
}

#: Rules of MISRA C:2012 that the addon of cppcheck 2.10 checks, by section; misra.txt has deviations.
CHECKED = {
    1: (4,), 2: (2, 3, 4, 5, 7), 3: (1, 2), 4: (1, 2), 5: (1, 2, 4, 5, 6, 7, 8, 9), 6: (1, 2), 7: (1, 2, 3, 4),
    8: (1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14), 9: (2, 3, 4, 5), 10: (1, 2, 3, 4, 5, 6, 7, 8),
    11: (1, 2, 3, 4, 5, 6, 7, 8, 9), 12: (1, 2, 3, 4), 13: (1, 3, 4, 5, 6), 14: (1, 2, 4), 15: (1, 2, 3, 4, 5, 6, 7),
    16: (1, 2, 3, 4, 5, 6, 7), 17: (1, 2, 3, 6, 7, 8), 18: (4, 5, 7, 8), 19: (2,),
    20: (1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14), 21: (*range(1, 13), 14, 15, 16, 19, 20, 21), 22: (5, 7, 8, 9, 10),
}  # fmt: skip

#: How many rules each section has, with amendments 1 and 2.
SECTIONS = {1: 4, 2: 7, 3: 2, 4: 2, 5: 9, 6: 2, 7: 4, 8: 14, 9: 5, 10: 8, 11: 9, 12: 5, 13: 6, 14: 4, 15: 7, 16: 7,
            17: 8, 18: 8, 19: 2, 20: 14, 21: 21, 22: 10}  # fmt: skip

#: Rules that nothing in the source can break, which cppcheck does not check.
NOTHING_THERE = {
    "18.6": "no address of a local variable is kept", "18.1": "each constant offset lies within its array, see 18.4",
    "17.4": "every function that is not void ends with return", "17.5": "static functions are called with whole parts",
    "21.13": "no function of <ctype.h>", "21.17": "no function of <string.h>", "21.18": "no function of <string.h>",
    "22.1": "nothing is allocated or opened", "22.2": "nothing is freed", "22.3": "no file", "22.4": "no file",
    "22.6": "no file", "19.1": "no object overlaps another in a copy", "12.5": "no sizeof of an array argument",
    "18.2": "no difference of pointers", "18.3": "pointers are not compared",
}  # fmt: skip


def safety_values(code: ControllerCode, run: Recording) -> dict[str, object]:
    """What ``safety.md`` states, for a recording of the test vector."""
    return {
        "commit": commit(),
        "faults": of_file(faults(code)),
        "bits": of_file(bits(code)),
        "goals": of_file(goals(code)),
        "requirements": of_file(requirements(code)),
        "misra": of_file(matrix()),
        "facts": list(code.facts.items()),
        "provoked": run.provocation is not None,
        "set_bits": set_bits(code, run),
        "spacing": SPACING,
        "stops": of_file(stops(code)),
        "category": code.whole_numbers[2],
        "falls": of_file(falls(code)),
        "checkable": code.stop.is_checkable,
    }


@cache
def commit() -> str:
    """The commit of flexhinf that writes: as installed from, or of the folder that it runs in; else its version, and
    why no commit is known."""
    file = Path(__file__).resolve()
    try:
        installed = json.loads(distribution("flexhinf").read_text("direct_url.json") or "{}")
        if found := installed.get("vcs_info", {}).get("commit_id"):
            return str(found)
    except PackageNotFoundError:  # it runs from a folder
        pass
    except ValueError as error:
        return f"not known: version {__version__}; direct_url.json of the installation: {error}"
    none = f"not known: version {__version__}, installed without its history"
    if shutil.which("git") is None or not any((folder / ".git").exists() for folder in file.parents):
        return none
    git = ("git", "-C", str(file.parent))
    try:
        if (
            _done(*git, "ls-files", "--error-unmatch", file.name).returncode == 1
        ):  # it lies in another repository
            return none
        changed = (
            ", with changes" if _said(*git, "status", "--porcelain", "--untracked-files=no", ".") else ""
        )
        return _said(*git, "rev-parse", "HEAD") + changed
    except subprocess.CalledProcessError as error:
        said = " ".join(str(error.stderr).split())[:200]
    except (OSError, subprocess.TimeoutExpired) as error:
        said = str(error)
    return f"not known: version {__version__}; git fails: {said}"


def _said(*command: str) -> str:
    done = _done(*command)
    done.check_returncode()
    return done.stdout.strip()


def _done(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)


def faults(code: ControllerCode) -> list[tuple[str, ...]]:
    """Every code of a step: what happened, what it does, after which time, and who must act how."""
    ms = 1e3 * code.controller.period
    missing = MISSING_LIMIT if code.predicts else 0
    times = {
        "STOPPED": f"{missing + 1} samples, {(missing + 1) * ms:g} ms, after the last measurement in time",
        "BAD_PERIOD": f"after 8 samples half a period too long, {8 * ms:g} ms; 2 to 4 where they are twice as long",
        "WENT_BACK": f"2 samples, {2 * ms:g} ms",
    }
    rows: list[tuple[str, ...]] = []
    for key, row in CODES.items():
        if key in code.codes and not (key == "BAD_MEASUREMENT" and code.predicts):
            what, _, does = row.meaning.partition(": ")
            acts = row.reaction.format(name=code.name)
            rows.append(
                (f"{row.value} `{code.upper(key)}`", what, does or "as usual", times.get(key, AT_ONCE), acts)
            )
    return rows


def bits(code: ControllerCode) -> list[tuple[str, ...]]:
    """Every bit of the status: what it says, the reaction, its time, and whether this controller watches it."""
    watch, found = code.controller.supervision, list[tuple[str, ...]]()
    for bit, text in zip(Status, STATUS, strict=True):
        event = EVENTS.get(bit)
        reaction = (
            "none: it is reported" if watch is None or event is None else watch.reactions.get(event, "none")
        )
        braked = (
            ""
            if watch is None or reaction != "brake"
            else f"path rate 1 to 0 within {watch.braking_time:g} s"
        )
        after = f"{watch.saturation_time:g} s at a limit" if watch and bit == Status.SATURATION else AT_ONCE
        if bit == Status.LIMIT_CYCLE:
            after = "several swings, as `swings` of the parameters says"
        watched = bit in code.able
        cells = (reaction, f"{after}{braked and '; then '}{braked}") if watched else ("not watched", "—")
        found.append((f"{bit.value} `{code.upper(str(bit.name))}`", text, *cells))
    return found


def stops(code: ControllerCode) -> list[tuple[str, ...]]:
    """Every reason of a protective stop: when it is said, and what to look at."""
    _, counted, _ = code.whole_numbers
    reasons = [(bit, STOPS[str(bit.name).lower()]) for bit in code.stop.reasons if bit & counted]
    return [(f"{bit:d} `{code.upper(f'STOP_{bit.name}')}`", *reason) for bit, reason in reasons]


def falls(code: ControllerCode) -> list[tuple[str, str, str]]:
    """Of each joint whether it has a brake, and how far it falls in `FALLS` where it has none."""
    if code.robot is None or all(code.robot.brakes):
        return []
    rows = zip(code.robot.joint_names, code.robot.brakes, fallen(code.controller, code.robot, FALLS))
    return [
        (name, "yes", "as far as the brake lets it") if brake else (name, "no", f"{way:.2g} rad")
        for name, brake, way in rows
    ]


def goals(code: ControllerCode) -> list[tuple[str, ...]]:
    """Every way in which a goal of a trajectory is refused or fails; nothing where no trajectory is followed."""
    follower = follower_of(code)
    if follower is None:
        return []
    n, ms = code.name, 1e3 * code.controller.period
    same = "nothing: the motion that there is goes on"
    begun = f"`{n}_follow_check`, `{n}_follow_start`: at once; a goal that waits: in the sample in which it would begin"
    behind = f", of where the arm was {follower.latency * ms:g} ms before" if follower.latency else ""
    sizes = zip(follower.robot.joint_names, follower.usual[0, 0].tolist())
    stated = [f"{size:g} of {markdown(joint)}" for joint, size in sizes if size > 0.0]
    paths = f"{', '.join(stated) or 'none'} unless goal or options change it"
    late = f"goal time, {follower.goal_time:g} s" if follower.goal_time else "the goal time, none"
    timeout = f"time-out, {follower.timeout:g} s" if follower.timeout else "the time-out, none"
    return [
        (
            f"-1 `{code.upper('FOLLOW_INVALID_GOAL')}`",
            "the goal cannot be followed, or not from the motion that there is: at a waypoint or between two of them a "
            "joint leaves its range or its speed limit, or hurries its drive; or another goal has replaced it",
            same,
            begun,
            "tell the sender; send one that begins where the arm is to be now",
        ),
        (
            f"-2 `{code.upper('FOLLOW_INVALID_JOINTS')}`",
            "no joint moves, or one is left out without `options.partial`",
            same,
            f"`{n}_follow_check`: at once",
            "tell the sender; name all joints",
        ),
        (
            f"-3 `{code.upper('FOLLOW_OLD_HEADER_TIMESTAMP')}`",
            "the trajectory is over before it begins",
            same,
            begun,
            "compare the clocks; send it anew",
        ),
        (
            f"-4 `{code.upper('FOLLOW_PATH_TOLERANCE_VIOLATED')}`",
            f"on its way a joint is farther from its place than the path tolerance, {paths}, or from its velocity; or "
            "`input.path_rate` is 0, as the controller has braked",
            f"comes to rest within `options.stop_time`, {follower.stop_time:g} s unless you change it, and holds; "
            "a goal that waits is dropped",
            f"{AT_ONCE}{behind}",
            "brake if the arm does not follow that stop; find what holds it",
        ),
        (
            f"-5 `{code.upper('FOLLOW_GOAL_TOLERANCE_VIOLATED')}`",
            "behind its path a joint is outside of the goal tolerance until the goal time or the time-out is over",
            "holds the end of the path",
            f"after {late}, or {timeout}, unless goal or options change it",
            "tell the sender; find what holds the arm",
        ),
        (
            f"`{code.upper('BAD_COMMAND')}` of `{n}_follow_row`, `{n}_follow_stream`",
            "a row from elsewhere jumps, leaves a range or a speed limit, is not finite, or twists a spring more than "
            "its drive can",
            "nothing: it only tells",
            AT_ONCE,
            f"do not give that row to `{n}_step`: repeat the one before, or brake",
        ),
    ]


def set_bits(code: ControllerCode, run: Recording) -> str:
    """Which bits of the status the test vector sets, of those that the controller can set."""
    ever = Status(0)
    for one in run.status:
        ever |= Status(one)
    names = [str(bit.name) for bit in Status if bit in code.able and bit in ever]
    missing = [str(bit.name) for bit in Status if bit in code.able and bit not in ever]
    text = f"set and compared: {', '.join(names) or 'none'}"
    return text + (f"; never set there: {', '.join(missing)}" if missing else "")


def requirements(code: ControllerCode) -> list[tuple[str, str, str]]:
    """What is promised, the function that keeps it, and what tests it."""
    n = code.name
    vector, rehearsal = f"`{n}_test.c`", f"`{n}_contract.c`"
    rows = [
        ("inputs are those of the simulation", f"`{n}_step`", f"{vector}, every row"),
        (
            "outputs are finite and within the narrower limits, whatever the code",
            f"`{n}_limit`, `{n}_hold`",
            f"{rehearsal}: after every step",
        ),
        ("nothing is computed before a start", f"`{n}_step`", f"{rehearsal}: `starts`"),
        ("a start that is not finite is refused", f"`{n}_start`", f"{rehearsal}: `starts`"),
        ("a command that is not finite changes nothing", f"`{n}_sample`", f"{rehearsal}: `samples`"),
        (
            "a wrong period is found, where the time between steps is given",
            f"`{n}_slipped`",
            f"{rehearsal}: `periods`",
        ),
        ("samples without a measurement end in STOPPED", f"`{n}_step`", f"{rehearsal}: `samples`"),
        (
            "an overwritten memory is found, and an earlier one taken",
            f"`{n}_went_back`",
            f"{rehearsal}: `overwritten`, `overwritten_parts`, `goes_back`",
        ),
        ("limits of the caller narrow, and never widen", f"`{n}_limit`", f"{rehearsal}: `limits`, `wide`"),
        (
            "parameters that the design is not for are found",
            f"`{n}_check`",
            f"{rehearsal}: `limits`, `checks`",
        ),
        ("flags that change results are refused", f"`{n}_init`, `{n}_exact`", "your build: `make test`"),
        ("bits of the status are set where they must be", f"`{n}_step`", f"{vector}, from row `BEGUN` on"),
    ]
    if code.controller.mode.checks_measurements:
        rows.append(
            ("measurements that cannot be are missing", f"`{n}_plausible`", f"{vector}, from row `BEGUN` on")
        )
    if "stop" in code.controller.memory.places:
        rows.append(("a brake ends at path rate 0", f"`{n}_reaction`", f"{vector}, from row `BEGUN` on"))
    if code.standstill is not None:
        rows.append(("rest at a pose", f"`{n}_rest`", f"{rehearsal}: `rests`"))
    if code.slows:
        rows.append(("a motion that is slowed", f"`{n}_slowed`", f"{rehearsal}: `rests`"))
    if follower_of(code) is not None:
        played = f"`{n}_follow_test.c`"
        rows += [
            ("trajectories are those of the simulation", f"`{n}_follow_step`", f"{played}, every event"),
            ("goals that cannot be followed are refused", f"`{n}_follow_check`", f"{played}: `refused`"),
            (
                "a goal ends once, and not before another replaces it",
                f"`{n}_follow_start`",
                f"{played}: `tell`",
            ),
            ("goals of two sources are noticed", f"`{n}_follow_contest`", f"{played}: `contest`"),
            (
                "rows from elsewhere that cannot be are refused",
                f"`{n}_follow_stream`",
                f"{played}: `rows`, `streams`",
            ),
        ]
    return rows


def matrix() -> list[tuple[str, str, str]]:
    """Compliance with MISRA C:2012 by section: rules that cppcheck finds kept, and others with how they are kept."""
    rows: list[tuple[str, str, str]] = []
    for section, count in SECTIONS.items():
        checked, others = CHECKED[section], [k for k in range(1, count + 1) if k not in CHECKED[section]]
        review = [f"{section}.{k}: {NOTHING_THERE.get(f'{section}.{k}', 'not checked')}" for k in others]
        rows.append((f"{section}", _listed(section, checked), "; ".join(review) or "none"))
    return rows


def _listed(section: int, rules: Sequence[int]) -> str:
    return ", ".join(f"{section}.{k}" for k in rules)
