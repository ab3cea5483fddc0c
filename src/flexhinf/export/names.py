"""What exported C is called: names that C takes, the design's numbers by name, the terms of the law, and its origin.

Names in C: valid identifiers, names of signals, and text that is safe in a comment.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.codegen.c import KEYWORDS, Real, comment, constant
from flexhinf.codegen.naming import distinct
from flexhinf.errors import refuse_if
from flexhinf.loop import Controller
from flexhinf.loop.controller.law_code import LawCode
from flexhinf.validation import value_text

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: And names of their headers: NAME.h must not be found in the place of one.
RESERVED = KEYWORDS | {
    "assert",
    "complex",
    "ctype",
    "errno",
    "fenv",
    "inttypes",
    "iso646",
    "limits",
    "locale",
    "math",
    "memory",
    "setjmp",
    "signal",
    "stdarg",
    "stdbool",
    "stddef",
    "stdint",
    "stdio",
    "stdlib",
    "string",
    "strings",
    "tgmath",
    "threads",
    "time",
    "unistd",
    "wchar",
    "wctype",
}

LONGEST = 31  # characters that every linker keeps apart


def checked_identifier(name: object) -> str:
    """A name for functions and files.

    Raises InvalidInput: if it is no identifier of C, is reserved, or is too long.
    """
    text = name if isinstance(name, str) else ""
    whole = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", text) is not None and len(text) <= LONGEST
    refuse_if(
        not whole or text.lower() in RESERVED,
        "This is no name for C.",
        f"expected a letter, then up to {LONGEST - 1} letters, digits and underscores, no word of C and no "
        f"header of its library, got {value_text(name)}",
        identifier_of(text) if text else "my_arm",
    )
    return text


def identifier_of(text: str) -> str:
    """A name for C that looks like the text."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_").lower()[:LONGEST] or "controller"
    if not name[0].isalpha() or name in RESERVED:
        name = f"arm_{name}"[:LONGEST]
    return name


def constants(prefix: str, names: Sequence[str]) -> list[str]:
    """Names of constants for signals, each once: ``ARM_Y_LINK_POSITION``."""
    plain = (re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_") for name in names)
    return distinct(f"{prefix}_{text or k}" for k, text in enumerate(plain))


#: What the numbers of a controller are.
PARTS = {
    "period": "sampling period, s; the code is made for this one",
    "law": "coefficients of the law",
    "operating_point": "state, then integrals, about which the law is",
    "operating_input": "input there",
    "lower": "least input",
    "upper": "largest input",
    "integral_gain": "slope of the input by the integrals, for the bound of what they push",
    "integral_relief": "what an input beyond its limits takes back of the integrals per sample: anti-windup",
    "parameters": "parameters of the estimator's model",
    "process_noise": "covariance of the process noise per sample",
    "measurement_noise": "covariance of the measurement noise",
    "inverse_slope": "integrals by input, where a law takes over",
    "decay": "factor per sample of what no integral reaches after a law took over",
    "closer": "how much closer another law's point must be before it takes over",
    "input_rate": "largest change of the input, per s",
    "command_lower": "least command",
    "command_upper": "largest command",
    "command_rate": "largest change of the command, per s",
    "measurement_lower": "least measurement; an element beyond it is missing, and counted in output.rejected",
    "measurement_upper": "largest measurement, likewise",
    "measurement_rate": "largest change of a measurement, per s, since it was last plausible, likewise",
    "reading_steps": "steps of the values of measurements; infinite: its prediction tells no repeated frame",
    "reading_windows": "shares of a change in the mean speed of a measurement",
    "fastest": "largest speed of each measurement, per s",
    "distances": "of each tracked position: where its own way away from its command begins to count, and its "
    "longest",
    "swing_sizes": "of each input: smallest swing that counts where it grows, and that counts always",
    "motor_rates": "accelerations of motors per input, position, twist, speed, and speed of the twist",
    "motor_spreads": "by how much these differ at the ends of tolerances",
    "motor_numbers": "of each motor: gains of its observer, accelerations that are left out, twist per unit of the "
    "signal that tells it, shares of the links",
    "misplaced": "how far a reading may be from where the controller begins",
    "longest_unseen": "samples for which one sensor may be missing or refused",
    "stop_on": "bits of the signs that stop the robot",
    "hardest": "largest accelerations of motors whose encoders nothing contradicts",
    "breakaway": "changes of their inputs that move them",
    "workspace": "least and largest commanded positions that the design is for",
    "swings": "of each input, then of each tracked position: how near to a limit counts as at it, the smallest swing, "
    "and how many make a limit cycle",
    "watching": "samples of the longest swing and of a saturation that lasts; fraction of the braking per sample, and "
    "the factor of what eases the input",
    "following": "largest distance of each tracked position from its command; infinite: it is not watched",
    "offset_decay": "factor per sample of the offsets of the first measurement",
    "integral_dead_zone": "errors up to this size are not integrated",
    "backlash": "gaps between measured motors and links",
    "dry_friction": "what dry friction takes of each input where its motor is commanded to move; the commanded speed "
    "from a third of which on it takes all; where stated, what it takes of slow motors, and how slow these are",
    "governor": "of each tracked position: how far from its command it is brought back, the speed and acceleration of "
    "that, its range, and how fast the last of it ends, 1/s",
    "governor_curves": "of each tracked position, the curve of its spring: three stiffnesses over the model's, and the "
    "twists of the model's spring at the torques between them",
    "resistance": "acceleration of each tracked position, per s^2, that the model does not explain, and above which a "
    "joint that is brought back lets go",
    "windup_line": "what integrals push at rest, by command from the operating point: of inputs without near limits",
    "windup_spread": "how much more they push, likewise",
    "windup_limit": "how much more they push at the operating point; infinite for an input that its limits keep nearer",
    "rcond_limit": "reciprocal condition of a correction below which the estimate is in doubt: eps over 0.001",
    "balance_state": "what each estimated load moves the equilibrium's state by",
    "balance_input": "and its input",
}

#: What a controller remembers between samples.
MEMORY = {
    "belief": "the estimator's mean and covariance, or root of it, and what it counts",
    "u": "the last input",
    "integral": "integrals of the errors of the tracked positions",
    "position": "tracked positions of the last sample",
    "reference": "the last command, as it was given",
    "started": "1 from the first sample on",
    "bias": "what the input still has beside that of the law, after a law took over",
    "active": "which law acts",
    "command": "the last command, within its limits, or as the law is shown it",
    "far": "of each tracked position, whether it is brought back to its command: 1 or 0, more where it is pushed",
    "hold": "of each tracked position: how it is held where something keeps it from its command",
    "watch": "of each input, then of each tracked position: what is counted of its swings and of its saturation",
    "ease": "what the input still has beside that of the law, after a following error",
    "status": "bits of the status, one by one",
    "stop": "whether the command is held; the path rate",
    "offset": "offsets of the first measurement",
    "offset_known": "whether they are known",
    "queue": "inputs that wait for their instant",
    "commands": "commands that wait for theirs",
    "doubt": "whether the estimate is in doubt, and at how many samples it was",
    "readings": "of each measurement: what was last believed, how fast it moves, how many were rejected",
    "motion": "of each joint whose spring two readings tell: how its motor is observed to move",
    "away": "of each tracked position: its own way away from its command",
    "opposed": "of each input: how long it has been at its limit against the motion",
    "swung": "of each input: what is counted of large and growing swings",
    "misplaced": "1 where the robot was not where the controller began",
    "pauses": "long pauses of the loop, of which a part is forgotten in each sample",
    "stop_record": "samples so far, the first one at which a sign would stop the robot, and which",
    "standstill": "of encoders of motors that nothing contradicts: when they changed last",
}

#: Rows of the parts that are tables.
ROWS = {
    "watch": {
        "extreme": "last extreme of each signal",
        "direction": "1 or -1, since it",
        "swings": "swings so far",
        "since": "samples since the last swing ended",
        "at_limit": "samples at a limit",
    },
    "status": {
        "outside": "bits of the status: 1 or 0",
        "limit_cycle": "likewise",
        "saturation": "likewise",
        "reacting": "likewise",
        "following_error": "likewise",
        "blocked": "likewise",
        "repeated_frame": "likewise",
        "sensor_lost": "likewise",
        "inconsistent": "likewise",
        "runaway": "likewise",
        "too_fast": "likewise",
        "opposed": "likewise",
        "oscillating": "likewise",
        "stuck": "likewise",
    },
    "readings": {
        "last": "the last believed reading",
        "since": "samples since then, 0 before the first one",
        "refused": "how many were rejected",
        "raw": "the last reading",
        "change": "its last change per sample",
        "before": "the one before",
        "speed": "mean change per sample",
        "predicted": "prediction when the frame changed last",
        "still": "samples since the reading changed",
        "lost": "rejected readings that count",
        "fresh": "1 where the next one is known to be measured since the last step",
    },
    "motion": {
        "position": "observed position",
        "speed": "observed speed",
        "known": "whether these are known: 1 or 0; below 0, for so many samples not",
        "contradicted": "samples for which a contradiction lasts",
    },
    "away": {
        "last": "the last position",
        "way": "own way away from the command",
        "long": "samples for which it is too long",
    },
    "standstill": {
        "speed": "their speed then",
        "input": "the input then",
        "pushed": "samples for which the input has been larger by enough to move the motor",
    },
    "opposed": {
        "most": "largest speed against the input while it is at its limit",
        "samples": "samples for which it is",
    },
    "swung": {
        "extreme": "last extreme",
        "foot": "the one before",
        "direction": "1 or -1",
        "since": "samples since the last swing ended",
        "size": "size of that",
        "count": "large or growing ones in a row",
    },
    "hold": {
        "share": "1, or less where the joint lets go",
        "push": "what the model does not explain, in resistances",
        "nearest": "where it was nearest to its command since then",
        "yielded": "whether it has yielded: 1 or 0",
    },
    "stop": {
        "held": "whether the command is held",
        "braked": "fraction of the braking that is done",
        "path_rate": "from 1 to 0",
    },
    "governor": {
        "distance": "of each tracked position, rad or m",
        "speed": "per s",
        "acceleration": "per s^2",
        "lower": "least position",
        "upper": "largest",
        "rate": "1/s",
    },
    "governor_curves": {
        "first": "stiffness up to the first torque, over that of the model",
        "second": "stiffness from there to the second",
        "third": "stiffness beyond",
        "low": "twist of the model's spring at the first torque, rad or m",
        "high": "twist at the second",
    },
    "swings": {
        "near_limit": "how near to a limit counts as at it",
        "smallest": "smallest swing that counts",
        "most": "so many are a limit cycle",
    },
    "watching": {
        "longest_swing": "samples",
        "longest_saturation": "samples",
        "braking": "fraction of the braking per sample",
        "easing": "factor per sample of what eases the input",
    },
}


def named_parameters(controller: Controller, units: Mapping[str, str]) -> Iterator[tuple[str, int, str]]:
    """Name, place from the first of them, and unit of each parameter of the estimator's model; elements of arrays are
    numbered, and have their units under `name[1]`, `name[2]`, …"""
    if controller.estimator is None:
        return
    first = 0
    for name, value in controller.estimator.plant.parameters.values.items():
        for k in range(value.size):
            label, known = (f"{name}_{k}", f"{name}[{k + 1}]") if value.ndim else (name, name)
            yield label, first + k, units.get(known, "")
        first += value.size


def parameter_units(controller: Controller, robot: Robot | None) -> dict[str, str]:
    """Unit of each parameter of the estimator's model, by the names of `named_parameters`, and whose it is: of several
    joints their names."""
    if controller.estimator is None:
        return {}
    plant = controller.estimator.plant
    joints: Sequence[str] = () if robot is None else robot.joint_names
    units = dict(plant.units) | ({} if robot is None else {p.name: p.unit for p in robot.parameters})
    for name, value in plant.parameters.values.items():
        for k in range(value.size if value.ndim and len(value) == len(joints) else 0):
            label, joint = f"{name}[{k + 1}]", joints[int(k * len(joints) // value.size)]
            units[label] = f"{units.get(label, '')} of {joint}{_axis(name, k)}".lstrip()
    return units


def _axis(name: str, k: int) -> str:
    """Which component element k of a robot's parameter is."""
    from flexhinf.robot.parameters import INERTIA, VECTOR

    axes = {"centre_of_mass": VECTOR, "inertia": INERTIA}.get(name, ())
    return f", {axes[k % len(axes)]}" if axes else ""


def law_terms(controller: Controller) -> list[str]:
    """What each number of the law multiplies, as ``motor_voltage: link_position^2 motor_velocity``, where the law is a
    polynomial in the deviations from its operating point; empty where it is not. Integrals are those of the errors."""
    code = LawCode(controller.laws[0], controller.composed)
    table, inputs = code.law.law_table, tuple(code.law.input_names)
    if table is None:
        return []
    states = [*code.law.state_names, *(f"integral_{k}" for k in range(table.n))][: table.n]
    terms = [_monomial(states, powers) for powers in table.exponents]
    if code.table is None:
        rows = [f"{name}: {term}" for name in inputs for term in terms]
    else:
        padded = [*inputs, *["unused"] * (code.columns - len(inputs))]
        rows = [f"{name}: {term}" for term in terms for name in padded]
    return rows * len(controller.laws)


def _monomial(states: Sequence[str], powers: np.ndarray) -> str:
    factors = [
        name if k == 1 else f"{name}^{k}" for name, k in zip(states, powers.tolist(), strict=True) if k
    ]
    return " ".join(factors)


#: The law up to so many numbers has one in a line, with what it multiplies.
LONGEST_LAW = 2000


def number_lines(
    places: Mapping[str, slice],
    values: np.ndarray,
    real: Real,
    about: Mapping[str, str],
    meanings: Mapping[str, Sequence[str]] | None = None,
    indent: str = "    ",
) -> str:
    """Numbers as constants of C, each group under a comment that says what it is; `meanings` of single numbers."""
    meanings = meanings or {}
    lines: list[str] = []
    for name, place in places.items():
        if place.start == place.stop:
            continue
        texts = [constant(float(value), real) for value in values[place]]
        texts = [text + "," * (place.start + k + 1 < len(values)) for k, text in enumerate(texts)]
        lines.append(f"/* {name}: {comment(about[name])} */")
        if len(meanings.get(name, [])) == len(texts) <= LONGEST_LAW:
            stated = zip(texts, meanings[name], strict=True)
            lines += [f"{text} /* {comment(what)} */" for text, what in stated]
        else:
            lines += [" ".join(texts[k : k + 4]) for k in range(0, len(texts), 4)]
    return "\n".join(f"{indent}{line}" for line in lines)


def default_lines(controller: Controller, values: np.ndarray, real: Real) -> str:
    """The numbers of a controller as constants of C."""
    meanings = {
        "law": law_terms(controller),
        "parameters": [name for name, *_ in named_parameters(controller, {})],  # with units in the header
    }
    return number_lines(controller.data.places, values, real, PARTS, meanings, "        ")


def unread_parameters(controller: Controller) -> set[int]:
    """Places among the parameters of the estimator's model of those that neither its flow nor its output depends on."""
    import casadi as ca

    if controller.estimator is None or not (plant := controller.estimator.plant).parameters.size:
        return set()
    flow = plant.traced_flow
    arguments = [ca.SX.sym(f"i{k}", flow.size1_in(k)) for k in range(flow.n_in())]
    x, u, _, p = arguments
    every = ca.vertcat(flow(*arguments), plant.traced_output(x, u, p))
    return {k for k, read in enumerate(ca.which_depends(every, p, 1)) if not read}


def origin_facts(controller: Controller, origin: Mapping[str, str]) -> dict[str, str]:
    """Lines for header and README: which robot and design it is, with which γ and degree, and by which command."""
    from flexhinf.hinf import HJISolution

    law = controller.law
    solved = (
        {"gamma": f"{law.gamma:.6g}", "degree of V": str(law.degree)} if isinstance(law, HJISolution) else {}
    )
    return {**solved, **origin}
