"""Laws compared for one task: each is a design of that law, judged by the requirements of all designs.

A rival has the task, robots, limits and requirements of the design, the sensors that its proponents would choose, and
the estimator that suits law and sensors. Its gains are found as `flexhinf design` finds them: the fastest that keep
all limits at the poses and in the moves of the search; or they are numbers that the user states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from flexhinf.designs.evidence import JudgedRuns, evidence_of
from flexhinf.designs.fields import law_of, readers, resolved, unchosen
from flexhinf.designs.judge import missed_by
from flexhinf.designs.laws import LawKind, check_drive, law_kind, serving
from flexhinf.designs.own_sensors import measuring
from flexhinf.designs.request import checked_specification
from flexhinf.designs.requirements import Reported, Requirement
from flexhinf.designs.specification import AUTO, FIELDS, Specification
from flexhinf.designs.workspace.rivals import Gains, check_numbers
from flexhinf.errors import FlexhinfError, refuse_if
from flexhinf.processors import single_blas
from flexhinf.robot import Robot
from flexhinf.validation import checked_path, read_toml

Progress = Callable[[str], None]

#: Name of the row of the design's own law.
DESIGN = "design"


def silent(text: str) -> None:
    """Tell nobody how far a design is."""


@dataclass(frozen=True, eq=False)
class ComparedController:
    """One row of a comparison."""

    name: str  # `DESIGN`, or the law's
    kind: LawKind
    judged: JudgedRuns | None = None  # the law in its loop; None for a law that could not be made
    stated: bool = False  # whether the user states the numbers of its gains
    failure: str = ""  # why it could not be made

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """Requirements that are not met, the worst first."""
        lines = () if self.judged is None else self.judged.missed
        return tuple(sorted(lines, key=missed_by, reverse=True))

    @property
    def met(self) -> bool:
        """Whether it meets every requirement."""
        return self.judged is not None and self.judged.met

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """All of them, judged; none for a law that could not be made."""
        return () if self.judged is None else self.judged.requirements

    def worst(self, what: str) -> Requirement | None:
        """The requirement of a name nearest to its limit, or farthest beyond it; None where it is not judged."""
        return max((line for line in self.requirements if line.what == what), key=missed_by, default=None)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Reported):
    """Several laws for one task, judged by the requirements of a design.

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
        return tuple(dict.fromkeys(line.what for row in self.compared for line in row.requirements))


@single_blas()
def compare(
    robot: Robot,
    specification: Specification,
    laws: Sequence[str] | None = None,
    progress: Progress | None = None,
    same_sensors: bool = False,
    gains: Mapping[str, Mapping[str, ArrayLike]] | None = None,
) -> Comparison:
    """Compare a design with designs of other laws for the same task; nothing is written.

    Each rival is designed as `design` designs it, the fastest that keeps all limits, and judged by the same
    requirements at the same poses, in the same moves and on the same robots.

    Parameters
    ----------
    robot, specification : Robot and Specification
        Of the design that the others are compared with. What only its own law reads is not asked of rivals.
    laws : sequence of str, optional
        Names of rivals, see `flexhinf.designs.laws`; by default the usual ones that serve the task.
    progress : callable, optional
        Called with what comes next, about `stages` times in all.
    same_sensors : bool
        Every law measures what the design measures, instead of what its proponents would choose.
    gains : mapping of str to numbers, optional
        Numbers of laws that are then not tuned: ``{"pid": {"bandwidth": [20.0, 30.0]}}``.

    Returns
    -------
    Comparison
        The laws with their runs; `save` writes the report.

    Raises
    ------
    InvalidInput
        For laws and gains that are not known or do not fit; and as `design`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> spec = fh.Specification(pose="10deg", start="0", law="modal", estimator="none")
    >>> comparison = fh.compare(fh.load_robot("paper"), spec, ["pd"])  # doctest: +SKIP
    >>> [row.name for row in comparison.rows]  # doctest: +SKIP
    ['design', 'pd']
    """
    s, progress = checked_specification(robot, specification), progress or silent
    stated: Mapping[str, Mapping[str, Any]] = gains or {}
    kinds = rivals(s, laws, tuple(stated), robot.drive)
    checked = {name: check_numbers(name, table, len(robot.joint_names)) for name, table in stated.items()}
    rows = [ComparedController(DESIGN, law_of(s), evidence_of(robot, s, progress))]
    for kind in kinds:
        numbers = checked.get(kind.name)
        rows.append(_row(robot, s, kind, progress, same_sensors, numbers))
    return Comparison(robot, s, tuple(rows))


def _row(
    robot: Robot,
    s: Specification,
    kind: LawKind,
    progress: Progress,
    same_sensors: bool,
    numbers: Gains | None,
) -> ComparedController:
    stated = numbers is not None
    try:
        own = rival_specification(robot, s, kind, same_sensors)
        judged = evidence_of(robot, own, partial(_prefixed, progress, kind.name), numbers=numbers)
    except FlexhinfError as error:
        return ComparedController(kind.name, kind, stated=stated, failure=" ".join(str(error).split()))
    return ComparedController(kind.name, kind, judged, stated)


def _prefixed(progress: Progress, name: str, text: str) -> None:
    progress(f"{name}: {text}")


def rivals(
    s: Specification, names: Sequence[str] | None = None, stated: Sequence[str] = (), drive: str = ""
) -> tuple[LawKind, ...]:
    """Laws to compare with the design of a specification on drives of a kind, each once; `stated` are those of which
    the user states gains.

    Raises `InvalidInput` for a name that is not known, for a law that does not serve the task or such drives, and for
    gains of a law that is not compared.
    """
    known = serving(drive, s.pose is not None)
    usual = [name for name, kind in known.items() if kind.usual]
    wanted = tuple(dict.fromkeys(names or (*usual, *stated)))
    others = [name for name in usual if name != law_of(s).name]
    for name in (*wanted, *stated):
        check_drive(law_kind(name), drive)
        refuse_if(
            name not in known,
            f"The law {name!r} is made about one pose, and the task is a workspace.",
            f"expected some of {', '.join(known)}",
            f"--laws {','.join(others[:2])}; or --pose home with {name}",
        )
    for name in stated:
        refuse_if(
            name not in wanted,
            f"Gains of {name!r} are stated, and it is not compared.",
            f"expected some of {', '.join(wanted)}",
            f"--laws {','.join((*wanted, name))}",
        )
    return tuple(known[name] for name in wanted if name != law_of(s).name or name in stated)


def rival_specification(robot: Robot, s: Specification, kind: LawKind, same_sensors: bool) -> Specification:
    """The specification of a law for the task of a design: its own sensors, and the estimator that suits both.

    An estimator that the design has by its law and sensors is none that all laws have. Fields that only some laws read
    are those of the design's law. Raises `SpecificationError` for an estimator that does not serve the law.
    """
    own = replace(
        unchosen(robot, s),
        law=kind.name,
        **{name: FIELDS[name].default for name, laws in readers().items() if laws},
    )
    if s.estimator == "none":
        return resolved(robot, own)
    if kind.sensors and not same_sensors:
        return resolved(robot, replace(measuring(robot, own, kind.sensors), estimator=AUTO))
    return resolved(robot, own)


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
