"""Kinds of laws, by name: what each is, its sensors, and how its gains are made.

The help of the command line has their names from here, so what needs a synthesis is imported late.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from flexhinf.errors import refuse_if
from flexhinf.extensions import Registry
from flexhinf.robot.drives import DRIVES
from flexhinf.validation import unknown_name

if TYPE_CHECKING:
    from flexhinf.arrays import Matrix, Vector
    from flexhinf.designs.laws.pose_model import PoseModel

#: The nonlinear H∞ law, which serves one pose by default.
NL_HINF = "nl-hinf"

#: The law of pairs of a link and a motor, which serves a workspace by default; its estimator has the same name.
MODAL = "modal"

#: Sensors that proponents of a law use: encoders on the motors; on the links too; torque sensors in the joints.
MOTOR, BOTH = ("motor_position",), ("link_position", "motor_position")
TORQUE, TORQUE_BOTH = (*MOTOR, "joint_torque"), (*BOTH, "joint_torque")


@dataclass(frozen=True)
class LawOver:
    """How the gains of a law are made at each pose of a workspace."""

    # (n, 5n): torques per deviation of link positions and velocities, motor positions and velocities, and per integral
    make: Callable[[PoseModel, Mapping[str, Vector]], Matrix]
    names: tuple[str, ...]  # numbers that a user may state
    variants: tuple[dict[str, float], ...] = ({},)  # what else the search chooses from, at each bandwidth
    of_states: bool = (
        False  # whether the gains are inputs per state of the model and integral, (n, states + n)
    )


@dataclass(frozen=True)
class LawKind:
    """A law of which designs are made, and compared."""

    name: str
    description: str
    source: str  # key into docs/references.bib, or who proposes it
    over: LawOver | None = None  # its gains at any pose; None for a law with a search of its own
    sensors: tuple[str, ...] = ()  # those that its proponents use; empty: the design's
    usual: bool = False  # whether it is compared where no laws are named
    about_pose: bool = False  # whether it is made about one pose, and serves no workspace
    fields: tuple[str, ...] = ()  # fields of a specification that it reads, and not every law
    place: int = 100  # in lists: the smaller, the earlier
    commands: str = ""  # what drives take that it is for, see `DriveKind.commands`; empty: any

    def fits(self, drive: str) -> bool:
        """Whether it is for robots with such drives, by the name of their kind; all of no drive."""
        return not drive or self.commands in ("", DRIVES[drive].commands)

    @property
    def any_pose(self) -> bool:
        """Whether it has gains at any pose, and so serves every task."""
        return not self.about_pose


#: All laws, by name.
LAWS: Registry[LawKind] = Registry("law", __package__ or "", lambda kind: kind.place)

#: Laws with a search of their own.
SEARCHED = (MODAL, NL_HINF)


def register(kind: LawKind) -> LawKind:
    """Add a law, and return it.

    Raises `InvalidInput` for a name that is there already or cannot be used, and for a law without gains.
    """
    refuse_if(
        kind.over is None and kind.name not in SEARCHED,
        f"The law {kind.name!r} has no gains.",
        "expected `over`, a LawOver with the function that makes them at a pose, got none",
        "over=LawOver(my_gains, names=('bandwidth',))",
    )
    return LAWS.register(kind)


def serving(drive: str = "", pose: bool = True) -> dict[str, LawKind]:
    """Laws for drives of a kind, and for one `pose` or for a workspace, by name."""
    return {name: kind for name, kind in LAWS.items() if kind.fits(drive) and (pose or kind.any_pose)}


def law_kind(name: str) -> LawKind:
    """The law of a name. Raises `InvalidInput` for a name that is not known, with the nearest that is."""
    if name in LAWS:
        return LAWS[name]
    raise unknown_name(f"There is no law {name!r}.", name, LAWS, "--laws pid,lqg")


def check_drive(kind: LawKind, drive: str) -> None:
    """Refuse a law of other drives than these."""
    fitting = [name for name in DRIVES if kind.fits(name)]
    usual = [name for name, each in serving(drive, pose=False).items() if each.usual]
    refuse_if(
        not kind.fits(drive),
        f"The law {kind.name!r} is for other drives.",
        f"expected a robot with drive = {' or '.join(map(repr, fitting))}, got {drive!r}",
        f"--laws {','.join(usual[:2])}",
    )
