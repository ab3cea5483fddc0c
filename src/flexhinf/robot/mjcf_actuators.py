"""The largest torque or force that the actuators of an MJCF file give to a joint."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.robot.parts import ask

_ON_JOINT = 1  # mjTRN_JOINT, mjTRN_JOINTINPARENT
_AFFINE, _NO_CLAMP = 1, 1 << 8  # mjBIAS_AFFINE; mjDSBL_CLAMPCTRL
_DIRECT = (0, 2, 3)  # mjDYN_NONE, mjDYN_FILTER, mjDYN_FILTEREXACT: the control is a force, if late


def largest_effort(model: Any, joint: int) -> float:
    """Largest torque or force that the actuators of a joint give in both directions; infinite where one of them has no
    limit that is known, or there is none."""
    low = high = 0.0
    acting = np.flatnonzero((model.actuator_trnid[:, 0] == joint) & (model.actuator_trntype <= _ON_JOINT))
    unclear = list[str]()
    for k in acting:
        gear, ends = float(model.actuator_gear[k, 0]), np.array([-np.inf, np.inf])
        understood = not model.actuator_gaintype[k] and model.actuator_dyntype[k] in _DIRECT
        kind, clamped = model.actuator_biastype[k], not model.opt.disableflags & _NO_CLAMP
        unbiased = not kind or (kind == _AFFINE and not np.any(model.actuator_biasprm[k, :3]))
        if understood and unbiased and model.actuator_ctrllimited[k] and clamped:
            ends = np.sort(model.actuator_gainprm[k, 0] * model.actuator_ctrlrange[k])
        if model.actuator_forcelimited[k]:  # which cuts the force before the gear
            ends = np.clip(ends, *model.actuator_forcerange[k])
        elif not understood:
            unclear.append(model.actuator(k).name or f"number {k + 1}")
        if gear:
            least, most = sorted(gear * float(end) for end in ends)
            low, high = low + least, high + most
    if not acting.size:
        low, high = -np.inf, np.inf
    if model.jnt_actfrclimited[joint]:
        own = model.jnt_actfrcrange[joint].tolist()
        low, high = max(low, own[0]), min(high, own[1])
    name = model.joint(joint).name
    same_sign = acting.size and not low < 0.0 < high
    ask(
        same_sign or (unclear and np.isinf(min(-low, high))),
        f"The motor limit of the joint {name!r} is unknown: "
        + (
            "its actuators push one way."
            if same_sign
            else f"actuator {', '.join(unclear)} is not understood."
        ),
        f"expected actuators with forcerange, or <motor> with ctrlrange, got {low:g} to {high:g}",
        f"effort_limit = … for {name!r} in [[joint]] of the elastic file",
    )
    return np.inf if same_sign else min(-low, high)
