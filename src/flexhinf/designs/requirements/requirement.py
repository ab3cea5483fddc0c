"""Judged requirements: a value with its limit, and whether it is met."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from flexhinf.drawers import Drawer
from flexhinf.notebook import Pictured
from flexhinf.numerals import number, without_noise

#: Relative tolerance of every limit, which is also the accuracy of the searches.
TOLERANCE = 0.02

#: What is said of a requirement that is met within it alone.
PAST = f"{100.0 * TOLERANCE:g} % past its limit at most, which counts as met"

#: The requirement of the links' speeds.
SPEED = "link speed"


#: Limits of angles and lengths below this one are shown in mrad and mm, rad or m.
SMALL = 0.02


def display_unit(unit: str, limit: float, degrees: bool = False) -> tuple[str, float]:
    """Unit in which a number with this limit is shown, and the factor to it: angles in degrees where the user gave
    these, else small angles in mrad; small lengths in mm."""
    if degrees and unit == "rad":
        return "°", 180.0 / math.pi
    return (f"m{unit}", 1e3) if unit in ("rad", "m") and 0.0 <= limit < SMALL else (unit, 1.0)


@dataclass(frozen=True, repr=False)
class Requirement:
    """One line of a specification."""

    what: str
    # limit, found: In `unit`
    limit: float = math.nan
    found: float = math.nan
    unit: str = ""
    at_most: bool = True  # Whether `limit` is an upper limit; otherwise a lower one
    where: str = ""  # The run or loop that was judged
    criterion: str = ""  # Definition of `found`
    stated_by: str = "default"  # The option that states the limit, or "default"
    joint: str = ""  # Joint of the worst value; empty for a robot of one joint, or a value without a joint
    at: float | None = None  # Time at which the value occurs, s; None for a value without a time
    field: str = ""  # Field of the specification that states the limit; "" if none does
    tolerance: float = TOLERANCE  # Relative
    detail: str = ""  # What else is known of `found`, a few words
    judged: bool = True  # False: the run is too short to tell, so the requirement is neither met nor missed

    @property
    def _kept(self) -> bool:
        low, high = self.limit * (1.0 - self.tolerance), self.limit * (1.0 + self.tolerance)
        return bool(self.found <= high if self.at_most else self.found >= low)

    @property
    def met(self) -> bool:
        """Whether the requirement is judged, and met within its tolerance."""
        return self.judged and self._kept

    @property
    def missed(self) -> bool:
        """Whether the requirement is judged, and not met."""
        return self.judged and not self._kept

    @property
    def within_tolerance(self) -> bool:
        """Whether the limit is exceeded by so little that the requirement counts as met."""
        return self.met and not (self.found <= self.limit if self.at_most else self.found >= self.limit)

    @property
    def row(self) -> dict[str, Any]:
        """All of it by name, for a file: its fields, and whether it is met."""
        return {**asdict(self), "met": self.met, "within_tolerance": self.within_tolerance}

    @property
    def judgement(self) -> str:
        """``met``, ``NOT MET``, ``not judged``, or, for a value slightly beyond the limit, ``met within 2 %``."""
        met = f"met within {100.0 * TOLERANCE:g} %" if self.within_tolerance else "met"
        return met if self.met else "NOT MET" if self.judged else "not judged"

    def unit_text(self, value: float) -> str:
        """The unit as it stands behind a value: with a space, but for degrees; 1 sample, 2 samples."""
        unit = "sample" if (self.unit, value) == ("samples", 1.0) else self.unit
        return unit if unit in ("", "°") else f" {unit}"

    @property
    def limit_text(self) -> str:
        """The limit with its sign and unit, for example ``≤ 60 V``."""
        return f"{'≤' if self.at_most else '≥'} {number(self.limit, 3)}{self.unit_text(self.limit)}"

    @property
    def value_text(self) -> str:
        """The value with its unit."""
        if math.isinf(self.found):
            return "diverges" if (self.found > 0.0) is self.at_most else "unlimited"
        found = without_noise(self.found, self.limit)
        return f"{number(found, 3)}{self.unit_text(found)}"

    @property
    def achieved_text(self) -> str:
        """The value with its unit, the joint and time of the worst one, and what else is known of it."""
        if math.isinf(self.found):
            return self.value_text
        places = [self.joint, "" if self.at is None else f"at {number(self.at, 3)} s", self.detail]
        where = f" ({', '.join(filter(None, places))})" if any(places) else ""
        return f"{self.value_text}{where}"

    @property
    def text(self) -> str:
        """One phrase, for example ``overshoot: 9 % (at most 5 %; the step, nominal robot)``."""
        limit = f"{'at most' if self.at_most else 'at least'} {self.limit_text.split(' ', 1)[1]}"
        return f"{self.what}: {self.achieved_text} ({'; '.join(filter(None, (limit, self.where)))})"

    def __str__(self) -> str:
        """The phrase and the judgement; small angles and lengths are in mrad and mm."""
        return f"{self.converted(degrees=False).text}: {self.judgement}"

    def __repr__(self) -> str:
        return f"<Requirement: {self}>"

    def converted(self, degrees: bool) -> Requirement:
        """The requirement with angles and speeds of links in `degrees` where the report has them; bandwidths stay.
        Without degrees small angles and lengths are in mrad and mm."""
        unit, factor = display_unit(self.unit, self.limit, degrees)
        if degrees and self.unit == "rad/s" and self.what == SPEED:
            unit, factor = "°/s", math.degrees(1.0)
        return (
            self
            if unit == self.unit
            else replace(self, limit=factor * self.limit, found=factor * self.found, unit=unit)
        )


#: What writes the report of a result into a folder, which is returned.
REPORT: Drawer[[str | Path], Path] = Drawer()


class Reported(Pictured):
    """Base of results that have a report."""

    def save(self, folder: str | Path) -> Path:
        """Write the report and its numbers, of a design also the controller, every run and ``design.toml``, into a
        folder, which is returned. `flexhinf.load_design` and `flexhinf.load_controller` take this folder."""
        return REPORT(self, folder)
