"""What a design's own judgement says, for everything that is made of the design: code, runs, campaigns, pages.

The judgement is in the table [result] of a design file, one row for each requirement. A run or a campaign judges some
of the requirements again, in its own runs; what it says stands beside the verdict on the design.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexhinf.designs.requirements.requirement import Requirement, display_unit
from flexhinf.numerals import number_text, without_noise
from flexhinf.robot.file_keys import is_dict, is_list
from flexhinf.validation import read_toml

if TYPE_CHECKING:
    from flexhinf.robot import Robot


#: What the table [result] of a design file has of a requirement; design.json has the rest of `Requirement.row` too.
ROW = ("what", "limit", "at_most", "found", "unit", "met", "within_tolerance", "where", "stated_by")


def result_row(line: Requirement) -> dict[str, Any]:
    """A judged requirement as a row of the table [result]."""
    row = line.row
    return {name: row[name] for name in ROW}


def stored_rows(file: Path) -> list[dict[str, Any]]:
    """The rows of the table [result] of a design file; empty where it has none."""
    result = read_toml(file, "design file").get("result", {})
    rows = result.get("requirements", []) if is_dict(result) else None
    return [row for row in rows if is_dict(row) and "met" in row] if is_list(rows) else []


def bound_name(row: Mapping[str, Any]) -> str:
    """On which side of its limit a row's number has to be."""
    return "at most" if row.get("at_most", True) else "at least"


@dataclass(frozen=True)
class DesignVerdict:
    """The verdict on a design, by its own requirements."""

    names: tuple[str, ...] = ()  # of all its requirements; none where its judgement is not known
    missed: tuple[str, ...] = ()  # a phrase for each that is not met

    @staticmethod
    def of(rows: Sequence[Mapping[str, Any]], degrees: bool = False) -> DesignVerdict:
        """By the rows of a result; `degrees`: whether angles are shown in degrees, as on the pages of the design."""
        missed = [row for row in rows if not row["met"]]
        names, texts = [row["what"] for row in missed], list[str]()
        for row in missed:
            unit, factor = display_unit(row["unit"], row["limit"], degrees)
            numbers = without_noise(row["found"], row["limit"]), row["limit"]
            found, limit = (number_text(factor * value, unit, 3) for value in numbers)
            found = "diverges" if math.isinf(row["found"]) else found
            where = f", {row.get('where') or 'nominal robot'}" if names.count(row["what"]) > 1 else ""
            texts.append(f"{row['what']}{where}: {found} ({bound_name(row)} {limit})")
        return DesignVerdict(tuple(str(row["what"]) for row in rows), tuple(texts))

    @staticmethod
    def read(stored: Any) -> DesignVerdict:
        """As `numbers` wrote it; not known where it is something else."""
        parts = [stored.get(key) for key in ("requirements", "not_met")] if is_dict(stored) else []
        lists = [tuple(map(str, part)) for part in parts if is_list(part)]
        return DesignVerdict(*lists) if len(lists) == 2 else DesignVerdict()

    @property
    def numbers(self) -> dict[str, Any] | None:
        """For a file: whether the design is met, all its requirements, and those not met; None where not known."""
        if not self.names:
            return None
        return {"met": self.met, "requirements": list(self.names), "not_met": list(self.missed)}

    @property
    def met(self) -> bool:
        """Whether the design is known to meet all its requirements."""
        return bool(self.names) and not self.missed

    @property
    def brief(self) -> str:
        """The verdict in one phrase, without what is not met."""
        count = len(self.missed)
        if not self.names:
            return "the design itself is not judged here: flexhinf design judges it"
        if not count:
            return f"all {len(self.names)} requirements of this design are met"
        return f"{count} of {len(self.names)} requirements of this design {'is' if count == 1 else 'are'} not met"

    @property
    def unmet(self) -> str:
        """Which requirements the design does not meet; "" if it meets all, or nothing is known."""
        return f"{self.brief}: {'; '.join(dict.fromkeys(self.missed))}" if self.missed else ""

    def beside(self, names: Iterable[str], brief: bool = False) -> str:
        """Sentences beside a judgement of what is made of the design: how many kinds of its requirements are judged
        again, by their `names`, how many are not, and the verdict; if `brief`, that only where it is met, as
        beside a status that says all else."""
        here, kinds = dict.fromkeys(name for name in names if name), dict.fromkeys(self.names)
        count = sum(name in here for name in kinds)
        own, left = len(here) - count, len(kinds) - count
        judged = (
            f"That is a part of the design's judgement: {count} of its {len(kinds)} kinds of requirements"
        )
        judged += f", and {own} more that it does not have" if own else ""
        judged += f"; the other {left} need other tests, which flexhinf design makes. " if left else ". "
        verdict = f"{self.unmet or self.brief}." if self.met or not brief else ""
        return f"{judged if self.names else ''}{verdict[:1].upper()}{verdict[1:]}".rstrip()


def estimated_text(robot: Robot) -> str:
    """Which numbers of a robot are estimates, on which a verdict about it rests; "" where none is."""
    count, texts = len(robot.joint_names), list[str]()
    for quantity, joints in robot.estimated.items():
        whose = f" of {len(joints)} joints" if len(joints) > 1 else f" of {joints[0]}" if joints else ""
        texts.append(f"{quantity.replace('_', ' ')}{whose if count > 1 else ''}")
    return f"estimated, not measured: {', '.join(texts)}" if texts else ""


#: Of a design that is not judged.
UNKNOWN = DesignVerdict()
