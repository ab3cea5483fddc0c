"""What a move must keep: a stated one is tracked, comes to rest and keeps the limits; a planned one only the last."""

from __future__ import annotations

import numpy as np

from flexhinf.design.along_move import AlongMove
from flexhinf.design.joint_limits import JointLimits
from flexhinf.design.requirements import Requirement, limit_requirements, stating_option
from flexhinf.design.responses import Move
from flexhinf.design.specification import TOLERANCE, Specification, SpecificationError
from flexhinf.loop.simulation.metrics import SETTLING_BAND

#: Default limit of the tracking error, as a fraction of the joint's way along the move.
TRACKING_FRACTION = 0.05

#: A joint that hardly moves has at least this fraction of the largest way of the joints of its kind.
LEAST_WAY = 0.1

#: A way of less than this is none, but rounding, or what a search for poses leaves, rad or m.
ROUNDING = 1e-9

STATED, PLANNED = "the stated move, nominal robot", "the planned move"


def move_requirements(
    s: Specification, limits: JointLimits, move: Move, along: AlongMove | None = None
) -> list[Requirement]:
    """Lines of the specification about the move; of one that is planned and not stated, only exceeded limits.

    Parameters
    ----------
    along : AlongMove, optional
        Margins at poses on the way; they are judged too.
    """
    if s.move is None:
        return limit_requirements(limits, move.response, PLANNED, always=False)
    most, option = tracking_limits(s, limits, move.ways), stating_option(s, "tracking_error")
    return [
        _nearest(
            limits, move, "tracking error", "largest_error", most, option,
            "largest distance of a true link position from the move, of the joint nearest to its limit",
        ),
        _nearest(
            limits, move, "distance after the move", "final_error", final_limits(limits, move.ways), "default",
            "largest distance from the end of the move in the last tenth of the run; required: 2 % of the joint's way",
        ),
        *limit_requirements(limits, move.response, STATED),
        *([] if along is None else margins_requirements(s, along)),
    ]  # fmt: skip


def margins_requirements(s: Specification, along: AlongMove) -> list[Requirement]:
    """Peak sensitivity, gain margin and, where it is required, damping at the worst pose along a move."""
    laws = f", {along.count} laws" if along.count > 1 else ""
    where = f"running loop at {len(along.times)} poses along the move{laws}"
    limits = {
        "peak_sensitivity": ("peak sensitivity", s.peak_sensitivity_limit),
        "gain_margin": ("gain margin", s.gain_margin_limit),
        "damping": (
            "damping of oscillations",
            along.least.damping and along.least.damping * (1.0 + TOLERANCE),
        ),
    }
    lines = []
    for figure, (what, limit) in limits.items():
        if limit:
            k = along.worst(figure)
            found = float(getattr(along.margins[k], figure))
            lines.append(
                Requirement(
                    what, limit, found, "", figure == "peak_sensitivity", where,
                    "worst pose; linearised about the robot at rest there", stating_option(s, figure),
                    at=float(along.times[k]),
                )
            )  # fmt: skip
    return lines


def tracking_limits(s: Specification, limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Largest tracking error (n,) of each joint, rad or m: as stated, or `TRACKING_FRACTION` of its way.

    Parameters
    ----------
    ways : (n,)
        `Move.ways`.

    Raises
    ------
    SpecificationError
        For a number of limits that is not the number of joints.
    """
    if s.tracking_error is None:
        return TRACKING_FRACTION * _counted(limits, ways)
    stated, count = np.array(s.tracking_error), len(limits.joints)
    if len(stated) not in (1, count):
        raise SpecificationError(
            "tracking_error",
            "The tracking error does not fit the joints.",
            f"expected one number, or one for each of {list(limits.joints)}, got {len(stated)}",
            example=",".join(f"{one:g}" for one in np.resize(stated, count)),
        )
    return np.array(np.broadcast_to(stated, (count,)))


def final_limits(limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Largest distance (n,) of each joint from the end of a move after it, rad or m."""
    return SETTLING_BAND * _counted(limits, ways)


def _counted(limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Way (n,) of each joint along the move; at least `LEAST_WAY` of the largest of its kind."""
    units = np.array(limits.position_units)
    largest = np.array([ways[units == unit].max() for unit in units])
    return np.maximum(ways, LEAST_WAY * np.where(largest > ROUNDING, largest, 0.1))


def _nearest(
    limits: JointLimits, move: Move, what: str, key: str, most: np.ndarray, option: str, criterion: str
) -> Requirement:
    """The line of the joint whose figure is nearest to its own limit (n,)."""
    rows = move.metrics
    if not rows:
        joint, found = int(np.argmin(most)), np.inf
    else:
        values = np.array([row[key] for row in rows])
        joint = int(np.argmax(values / most))
        found = float(values[joint])
    name = limits.joints[joint] if len(limits.joints) > 1 else ""
    unit, limit = limits.position_units[joint], float(most[joint])
    return Requirement(what, limit, found, unit, True, STATED, criterion, option, name)
