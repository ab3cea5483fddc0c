"""Link positions as users state them, within the limits of their joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant.plant import pose_values
from flexhinf.robot.parameters import TURNING, Stated

#: A pose beyond one turn was probably meant in degrees.
TURN = 2.0 * np.pi * (1.0 + 1e-9)


def checked_pose(pose: Any, default: np.ndarray, links: Any, robot: str) -> np.ndarray:
    """Link positions (n,) within the limits, from a sequence, a mapping by joint, a number for one joint, or None."""
    names = links.tree.names
    if pose is None:
        pose = default
    if isinstance(pose, Mapping):
        by_name = cast("Mapping[str, Any]", pose)
        named = {name.removeprefix("link_position_"): value for name, value in by_name.items()}
        if len(names) == 1 and "link_position" in named:
            named[names[0]] = named.pop("link_position")
        pose = dict(zip(names, default)) | named
        stated = list(pose.values())
    else:
        stated = list(np.atleast_1d(np.asarray(pose, object)))
    values = pose_values(pose, names, f"robot {robot!r}")
    for joint, limits, slides, value, text in zip(names, links.limits, links.slides, values, stated):
        low, high = limits or ((-np.inf, np.inf) if slides else (-TURN, TURN))
        if low <= value <= high:
            continue
        unit, size = "m" if slides else "rad", 1.0
        if isinstance(text, Stated) and text.unit.lower() in TURNING and not slides:
            unit, size = text.unit, TURNING[text.unit.lower()]
        got = f"{text.number}{text.unit}" if isinstance(text, Stated) and text.number else f"{value:g} {unit}"
        # Degrees may be meant by a number without a unit, where as many degrees would be allowed.
        within = abs(value) > TURN and low <= np.deg2rad(value) <= high
        degrees = within and not (isinstance(text, Stated) or slides)
        what, advice = f"The pose is outside the limits of joint {joint!r}.", "a pose within the limits"
        if limits is None:
            what = f"The pose turns joint {joint!r} by {got}, more than once around."
            advice = "an angle within one turn, or limits in the robot's file, as a joint that turns further has them"
        if degrees:
            advice = (
                f"{value:g}deg in commands and specifications, np.deg2rad({value:g}) elsewhere; or {advice}"
            )
        got += "; were degrees meant?" if degrees else ""
        raise InvalidInput(what, f"expected {low / size:.6g} to {high / size:.6g} {unit}, got {got}", advice)
    return values


#: Range of a joint, rad or m, beyond which one of its ends stands for none.
FARTHEST = 1e3


def checked_home(home: Any, links: Any, robot: str) -> np.ndarray:
    """Link positions (n,) of a robot's home, zeros by default; refused outside the limits, with the line to write."""
    names = links.tree.names
    values = np.zeros(len(names)) if home is None else pose_values(home, names, f"robot {robot!r}")
    expected, got, within = list[str](), list[str](), list[float]()
    for name, limits, slides, value in zip(names, links.limits, links.slides, values.tolist()):
        low, high = limits or ((-np.inf, np.inf) if slides else (-TURN, TURN))
        unit, inside = "m" if slides else "rad", low <= value <= high
        degrees = not slides and abs(value) > TURN and low <= np.deg2rad(value) <= high
        if not inside:
            expected.append(f"{low:.6g} to {high:.6g} {unit} for {name!r}")
            got.append(f"{value:g} {unit} for {name!r}{' (were degrees meant?)' if degrees else ''}")
        middle = np.deg2rad(value) if degrees else (low + high) / 2.0
        if not degrees and high - low > FARTHEST:  # an end stands for none: the nearer one is a place
            middle = min(max(value, low), high)
        within.append(value if inside else float(f"{middle:.4g}"))
    refuse_if(
        got,
        f"The home pose is outside the limits: {', '.join(text.rpartition(' for ')[2] for text in expected)}.",
        f"expected {', '.join(expected)}, got {', '.join(got)}",
        f"home = {within} at the top of the robot file",
    )
    return values
