"""Laws compared over a workspace: each runs in the product's own loop, and is judged as a design is.

A rival takes the place of the law in `WorkspaceSetup`: sensors as its proponents have them, the same estimator, limits,
anti-windup, feedforward by the inverse dynamics and of dry friction, moves and robots. It gets the largest bandwidth
whose loops keep all limits with the reserve of the design's search, at the poses of that search, and whose first ten
moves of robots at corners of the tolerances keep all limits of moves; or the numbers that the user states. What is
judged then are other poses and other moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.design.laws import DESIGN, LawKind, check_drive, law_kind, laws_over
from flexhinf.design.own_sensors import measuring
from flexhinf.design.requirements import Reported, Requirement
from flexhinf.design.specification import Specification
from flexhinf.design.workspace.design import check_loop, judged_design
from flexhinf.design.workspace.evidence import WorkspaceEvidence
from flexhinf.design.workspace.judgement import missed_by, move_requirements
from flexhinf.design.workspace.law_file import stated_workspace
from flexhinf.design.workspace.preset import selected_law
from flexhinf.design.workspace.rivals import check_numbers, home_bandwidths, rival_law
from flexhinf.design.workspace.search import MOTORS_RANDOM, RANDOM, ChosenPoses, motors_alone
from flexhinf.design.workspace.setup import CHOSEN_SEED, WorkspaceSetup
from flexhinf.errors import FlexhinfError, NumericalFailure, refuse_if
from flexhinf.robot import Robot
from flexhinf.robot.waypoints import LIMITS
from flexhinf.validation import checked_path, read_toml

Progress = Callable[[str], None]

#: Numbers of a law by name: one, or one for each joint.
Numbers = Mapping[str, tuple[float, ...]]

#: Bandwidths of the search, rad/s, the fastest first; their ratio, and the steps of the bisection between two of them.
RATIO, BISECTIONS = math.sqrt(2.0), 2
BANDWIDTHS = tuple(160.0 * 2.0 ** (-0.5 * k) for k in range(12))

#: Poses by which a rival is tuned, and robots at corners of the tolerances at each: its fastest gains are at a limit,
#: so it needs more poses than the design, which has a choice of six bandwidths.
TUNING_POSES = (100, 1)

#: Moves by which a rival is tuned, and how many bandwidths are tried in them.
TUNING_MOVES, TIMES = 10, 4

#: Least excess of a loop that lacks something.
TINY = [0.0, 1e-12, 0.0, 0.0]


@dataclass(frozen=True, eq=False)
class ComparedController:
    """One row of a comparison over a workspace."""

    kind: LawKind
    judged: WorkspaceEvidence | None = None  # the law in its loop; None for a law that could not be made
    numbers: Numbers | None = None  # of which the gains are made; None of the design
    stated: bool = False  # whether the user states them
    failure: str = ""  # why it could not be made

    @property
    def name(self) -> str:
        """Of the law."""
        return self.kind.name

    @cached_property
    def bandwidth(self) -> float | None:
        """The largest of all joints, rad/s, of a rival at home; None where gains are stated without one."""
        if self.judged is None:
            return None
        if self.numbers is None:
            return float(self.judged.setup.gains.weights.bandwidth)
        known = "bandwidth" in self.numbers
        return float(home_bandwidths(self.judged.setup, self.numbers).max()) if known else None

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """Requirements that are not met, the worst first."""
        lines = () if self.judged is None else self.judged.missed
        return tuple(sorted(lines, key=missed_by, reverse=True))

    @property
    def met(self) -> bool:
        """Whether it meets every requirement."""
        return self.judged is not None and self.judged.met

    def worst(self, what: str) -> Requirement | None:
        """The requirement of a name nearest to its limit, or farthest beyond it; None where it is not judged."""
        lines = () if self.judged is None else self.judged.requirements
        return max((line for line in lines if line.what == what), key=missed_by, default=None)


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceComparison(Reported):
    """Several laws over a workspace, judged by the requirements of a design.

    Examples
    --------
    >>> import flexhinf as fh
    >>> wanted = fh.Specification(workspace=((0.0, 0.02),), draws=0, estimator="none")
    >>> gains = {"pid": {"bandwidth": 12.0}}
    >>> compared = fh.compare(fh.load_robot("paper"), wanted, ["pid"], gains=gains)  # doctest: +SKIP
    >>> [row.name for row in compared.rows]  # doctest: +SKIP
    ['design', 'pid']
    """

    robot: Robot
    specification: Specification
    rows: tuple[ComparedController, ...]  # the design's own law first

    def summary(self) -> dict[str, str]:
        """Robot, which laws meet all requirements, and which do not."""
        parts = {
            "meet every requirement": [row.name for row in self.rows if row.met],
            "do not": [f"{row.name} ({len(row.missed)})" for row in self.compared if not row.met],
            "not compared": [row.name for row in self.rows if row.failure],
        }
        return {"robot": self.robot.name} | {what: ", ".join(laws) for what, laws in parts.items() if laws}

    @property
    def own(self) -> ComparedController:
        """The design."""
        return self.rows[0]

    @property
    def compared(self) -> tuple[ComparedController, ...]:
        """Rows of laws that could be made."""
        return tuple(row for row in self.rows if row.judged is not None)

    def row(self, name: str) -> ComparedController:
        """The row of a law, by name."""
        return next(row for row in self.rows if row.name == name)

    @property
    def whats(self) -> tuple[str, ...]:
        """Names of what is required of any law, in the order of a design's list."""
        lines = (line.what for row in self.compared if row.judged for line in row.judged.requirements)
        return tuple(dict.fromkeys(lines))


def rival_names(names: Sequence[str] | None, stated: Mapping[str, Any], drive: str = "") -> tuple[str, ...]:
    """Laws to compare with the design over a workspace on drives of a kind, each once.

    Raises `InvalidInput` for a name that is not known, for a law of one pose or of other drives, and for numbers of a
    law that is not compared.
    """
    wanted = tuple(dict.fromkeys(names or (*laws_over(usual=True, drive=drive), *stated)))
    for name in (*wanted, *stated):
        check_drive(law_kind(name), drive)
        refuse_if(
            name not in (*laws_over(), DESIGN) or (name == DESIGN and name in stated),
            f"The law {name!r} is not compared over a workspace{' with stated gains' * (name == DESIGN)}.",
            f"expected some of {', '.join(laws_over())}",
            "--laws pid,torque-i; or --pose with a goal, where laws of one pose are compared",
        )
    for name in stated:
        refuse_if(
            name not in wanted,
            f"Gains of {name!r} are stated, and it is not compared.",
            f"expected some of {', '.join(wanted)}",
            f"--laws {','.join((*wanted, name))}",
        )
    return tuple(name for name in wanted if name != DESIGN)


def read_gains(path: str | Path) -> dict[str, dict[str, Any]]:
    """Numbers of laws from a TOML file with a table for each, such as ``[pid]`` with ``bandwidth = [20.0, 30.0]``.

    Raises `InvalidInput` for what is no such file.
    """
    file = checked_path("The file of gains", path)
    refuse_if(
        not file.is_file(),
        f"There is no file of gains {str(path)[:120]!r}.",
        "expected a TOML file with a table for each law",
        "[pid] and below it bandwidth = 20.0",
    )
    tables = read_toml(file, "file of gains")
    for name, table in tables.items():
        refuse_if(
            not isinstance(table, dict),
            "Gains are in tables of laws.",
            f"expected [pid] or another law, got {name} = {str(table)[:60]}",
            f"[pid] above {name}",
        )
    refuse_if(
        not tables, "The file of gains is empty.", "expected a table for a law", "[pid]\nbandwidth = 20.0"
    )
    return tables


def check_kind(workspace: bool, tuned: bool, searched: bool, gains: bool) -> None:
    """Refuse what only a comparison of the other kind reads: ways to tune and candidates at a pose, gains over a
    workspace."""
    for stated, name in ((tuned, "tune"), (searched, "candidates")):
        refuse_if(
            workspace and stated,
            f"--{name} has no effect over a workspace.",
            "expected one rule for all: the largest bandwidth that keeps every limit",
            f"leave out --{name}; or --pose with a goal, where laws are tuned for a criterion",
        )
    refuse_if(
        not workspace and gains,
        "Gains are stated for laws over a workspace.",
        "expected no gains at a pose, where every law is tuned",
        "leave out --gains; or leave out --pose and other options of one pose",
    )


def compare_stages(own: list[tuple[str, float]], laws: Sequence[str], drive: str) -> list[tuple[str, float]]:
    """The work steps of a comparison, of those of the design: for each rival its search, and the judgement."""
    rivals = rival_names(laws, {}, drive)
    judged = [(what, part) for what, part in own if not what.startswith("gains")]
    return [
        *own,
        *((f"{name}: {what}", part) for name in rivals for what, part in [("tune", 2.5), *judged]),
    ]


def compare_over_workspace(
    robot: Robot,
    s: Specification,
    laws: Sequence[str] | None = None,
    progress: Progress = lambda text: None,
    same_sensors: bool = False,
    gains: Mapping[str, Mapping[str, ArrayLike]] | None = None,
) -> WorkspaceComparison:
    """Compare a design for a workspace with other laws, judged alike; parameters as of `flexhinf.compare`.

    Raises `InvalidInput` for laws and numbers that do not fit, and as `design_workspace`.
    """
    stated: Mapping[str, Mapping[str, Any]] = gains or {}
    names = rival_names(laws, stated, robot.drive)
    checked = {name: check_numbers(name, table, len(robot.joint_names)) for name, table in stated.items()}
    check_loop(robot, s)
    s = replace(s, workspace=LIMITS) if s.workspace is None else s
    setup, _ = selected_law(robot, s, stated_workspace(robot, s.workspace), progress)
    rows = [ComparedController(law_kind(DESIGN), judged_design(setup, progress, undamped=False))]
    for name in names:
        kind = law_kind(name)
        progress(f"{name}: tune{' (stated gains)' * (name in checked)}")
        try:
            found = _RivalSearch(setup, kind, same_sensors)
            rival, numbers = found.stated(checked[name]) if name in checked else found.tuned()
            judged = judged_design(rival, partial(_prefixed, progress, name), undamped=False)
        except FlexhinfError as error:
            rows.append(ComparedController(kind, failure=" ".join(str(error).split())))
        else:
            rows.append(ComparedController(kind, judged, numbers, name in checked))
    return WorkspaceComparison(robot, s, tuple(rows))


def _prefixed(progress: Progress, name: str, text: str) -> None:
    progress(f"{name}: {text}")


class _RivalSearch:
    """The search for a rival."""

    def __init__(self, own: WorkspaceSetup, kind: LawKind, same_sensors: bool) -> None:
        s = own.specification
        if kind.sensors and not same_sensors and s.estimator != "none":
            s = measuring(own.robot, s, kind.sensors[0])
        self.own, self.kind, self.specification = replace(own, specification=s), kind, s
        self.poses = ChosenPoses(own.robot, s, own.workspace, 2, sizes=TUNING_POSES)
        known = s.estimator == "none" or s.process_noise is not None or s.torque_noise is not None
        tried = MOTORS_RANDOM if motors_alone(own.robot, s) else RANDOM
        self.torques = tried[: 1 if known else None]

    def stated(self, numbers: Numbers) -> tuple[WorkspaceSetup, Numbers]:
        """The setup with stated numbers, with the estimator that lacks least."""
        setups = [*self._at(numbers)]
        least, best = [math.inf], setups[0]
        for setup in setups:
            excess = self.poses.excess(setup, least)  # ends at the first pose at which it lacks more
            if excess is not None:
                least, best = excess.tolist(), setup
            if not any(least):
                break
        return replace(best, specification=self.specification), numbers

    def tuned(self) -> tuple[WorkspaceSetup, Numbers]:
        """The fastest that keeps all limits; where none does, that which lacks least."""
        place, lack, setup, numbers = self._scan(0)
        if any(lack) or not numbers:
            return setup, numbers
        tried = [(self._missed(setup), setup, numbers)]
        while tried[-1][0] > 1.0 and len(tried) < TIMES and place + 1 < len(BANDWIDTHS):
            place, lack, setup, numbers = self._scan(place + 1)
            if any(lack):
                break
            tried.append((self._missed(setup), setup, numbers))
        missed, setup, numbers = min(tried, key=lambda one: one[0])
        step = RATIO
        for _ in range(BISECTIONS if missed <= 1.0 and place > 0 else 0):
            step = math.sqrt(step)
            setup, numbers = self._faster(setup, numbers, step)
        return setup, numbers

    def _scan(self, first: int) -> tuple[int, list[float], WorkspaceSetup, Numbers]:
        """The first place in `BANDWIDTHS` from one on with a setup whose loops lack nothing, or least of all: the
        place, what they lack, and the setup with its numbers."""
        least, chosen = [math.inf], None
        for place, numbers, setup in self._candidates(first):
            excess = self.poses.excess(setup, least)
            if excess is not None:
                least, chosen = excess.tolist(), (place, setup, numbers)
            if not any(least):
                break
        if chosen is None:
            raise NumericalFailure(
                f"No loop of {self.kind.name} can be judged.",
                "all that were tried are far from stable",
                f"--laws without {self.kind.name}, or gains of your own (--gains)",
            )
        place, setup, numbers = chosen
        return place, least, replace(setup, specification=self.specification), numbers

    def _candidates(self, first: int) -> Iterator[tuple[int, Numbers, WorkspaceSetup]]:
        """Setups from a place in `BANDWIDTHS` on, the fastest first."""
        law = laws_over()[self.kind.name]
        if not law.names:  # no gain to choose
            yield from ((first, {}, setup) for setup in self._at({}))
            return
        for place in range(first, len(BANDWIDTHS)):
            for more in law.variants:
                numbers = {name: (x,) for name, x in {"bandwidth": BANDWIDTHS[place], **more}.items()}
                yield from ((place, numbers, setup) for setup in self._at(numbers))

    def _at(self, numbers: Numbers) -> Iterator[WorkspaceSetup]:
        """The law with each estimator, to be judged with the reserve."""
        base = replace(self.own, specification=self.poses.wanted)
        law = rival_law(base, self.kind.name, numbers)
        for random in self.torques:
            yield replace(base, law=law, random=random)

    def _faster(self, setup: WorkspaceSetup, numbers: Numbers, step: float) -> tuple[WorkspaceSetup, Numbers]:
        """The setup with bandwidths that are larger by the factor `step` if it keeps all limits, else this one."""
        more = {**numbers, "bandwidth": tuple(step * x for x in numbers["bandwidth"])}
        for other in self._at(more):
            if self.poses.excess(other, TINY) is not None:
                other = replace(other, specification=self.specification)
                return (other, more) if self._missed(other) <= 1.0 else (setup, numbers)
        return setup, numbers

    def _missed(self, setup: WorkspaceSetup) -> float:
        """Worst of what is required of moves, found over allowed, in the first moves of robots at corners; at most 1
        where all is met."""
        goals, _ = setup.goals(TUNING_MOVES + 1, CHOSEN_SEED)
        robots = setup.true.robot.random_corners(TUNING_MOVES, CHOSEN_SEED) or [None] * TUNING_MOVES
        moves = setup.moves([(goals[k : k + 2], values, k) for k, values in enumerate(robots)])
        lines = [line for line in move_requirements(setup, moves, "") if line.missed]
        return max((float(np.nan_to_num(missed_by(line), nan=math.inf)) for line in lines), default=1.0)
