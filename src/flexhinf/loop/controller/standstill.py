"""A start at rest at any pose: the state, the input and the integrals with which a controller holds the robot there.

A law of one pose holds another one where its integrals can supply the difference: u* + k(x − x*, e) = u with the
equilibrium (x, u) of the model at that pose. A polynomial law without such a root, and a law without integrals, cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.codegen import DIRECT
from flexhinf.errors import refuse_if
from flexhinf.loop.controller.bumpless import bumpless_transfer, inverse_slope
from flexhinf.loop.controller.estimated import EstimatedStates
from flexhinf.loop.controller.governor import first_of_joints
from flexhinf.loop.controller.law_code import law_slope
from flexhinf.loop.controller.laws import Schedule
from flexhinf.loop.controller.options import Limits
from flexhinf.loop.controller.readings import first_readings
from flexhinf.loop.controller.signs import first_signs
from flexhinf.loop.controller.status import first_counters
from flexhinf.plant import Estimator, Law, ProblemLaw
from flexhinf.plant.plant import equilibrium_at, pose_values
from flexhinf.validation import value_text

#: Rounds of Broyden's steps, and what may be left of an input, relative to 1 and the largest one.
ROUNDS, TOLERANCE = 5, 1e-6


def first_values(controller: Any, state: Any = None, input: Any = None) -> dict[str, Any]:
    """Parts of a controller's memory before its first step, of an estimated state (N,) and an input (m,) before it."""
    estimator, mode, zeros = controller.estimator, controller.mode, np.zeros(len(controller.tracked))
    belief: dict[str, Any] = {}
    if estimator is not None:
        belief["belief"] = list(estimator.initial if state is None else estimator.initial_at(state))
    u = controller.input_before(input, state)
    return {
        **belief, "u": u, "integral": zeros, "position": zeros, "reference": controller.operating_reference,
        "started": np.zeros(1), **({"bias": np.zeros(len(u))} if mode.takes_over else {}),
        **({"active": np.eye(mode.laws)[0]} if mode.laws > 1 else {}), **first_of_joints(mode, zeros),
        **({"command": controller.operating_reference if mode.moving else zeros} if mode.changes_command else {}),
        **first_counters(len(u), len(zeros), mode.reactions, mode.protected is not None),
        **(first_signs(mode.protected, u, zeros) if mode.protected else {}),
        **(dict.fromkeys(("offset", "offset_known"), np.zeros(len(controller.measured))) if mode.has_offset else {}),
        **({"queue": np.tile(u, (mode.latency, 1))} if mode.latency else {}),
        **({"commands": np.tile(controller.operating_reference, (mode.command_lead, 1))} if mode.command_lead else {}),
        **({"doubt": np.zeros(2)} if controller.doubts else {}),
        **({"readings": first_readings(len(controller.measured))} if mode.checks_measurements else {}),
    }  # fmt: skip


def standstill_memory(
    law: Law, estimator: Estimator | None, states: EstimatedStates, limits: Limits, moving: bool, pose: Any
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Estimated state (N,) and input (m,) of the model at rest with the tracked states at a pose (k,), and the parts of
    a controller's memory that hold it there: integrals, positions and command.

    Raises InvalidInput: without a model or tracked states, for a pose that does not fit, or one that the inputs or the
    law cannot hold; NumericalFailure: if there is no equilibrium.
    """
    own, tracked = law.problem.plant if isinstance(law, ProblemLaw) else None, law.tracked
    model = own if estimator is None else estimator.plant
    refuse_if(
        model is None or not tracked,
        "This controller knows no equilibria.",
        "expected an estimator with its model, and a law with integrals, got "
        f"{'no model' if model is None else 'no integrals'}",
        "reset(state, input) with numbers of your own",
    )
    assert model is not None
    whole, u = equilibrium_at(
        model, tracked, pose_values(pose, tracked, "controller"), states.start if states.places else None
    )
    x = states.own(whole)
    refuse_if(
        np.any((u < limits.lower) | (u > limits.upper)),
        "The inputs cannot hold the robot at this pose.",
        f"expected an input within {limits.lower.tolist()} and {limits.upper.tolist()}, needed {u.tolist()} at "
        f"{value_text(pose)}",
        "another pose, or a larger saturation",
    )
    position = x[[law.plant_states.index(name) for name in tracked]]
    if moving:
        integrals, command = np.zeros(len(tracked)), np.concatenate([x, u])
    else:
        integrals, command = equilibrium_integrals(law, x, u), position
    return whole, u, {"integral": integrals, "position": position, "reference": command}


def velocity_places(states: Sequence[str]) -> tuple[int, ...]:
    """Places of the states that are named velocities or speeds, which are zero at rest."""
    return tuple(k for k, name in enumerate(states) if {"velocity", "speed"} & set(name.split("_")))


def equilibrium_integrals(law: Law, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Integrals (k,) with which the law, of a `Schedule` the nearest, gives the input u (m,) at the state x (n,).

    Raises InvalidInput: if there are none.
    """
    if isinstance(law, Schedule):
        law = law.laws[law.acting(x)]
    point, data = np.asarray(law.operating_point, dtype=float), np.ravel(law.law_data)
    n, wanted = len(x), u - np.asarray(law.operating_input, dtype=float)
    inverse, integrals, bias = inverse_slope(law_slope(law)[:, n:]), point[n:], np.zeros(len(u))

    def value(deviation: Any) -> Any:
        return np.asarray(law.evaluate_law(deviation, data), dtype=float)

    for _ in range(ROUNDS):
        deviation = np.concatenate([x, integrals]) - point
        _, integrals, bias = bumpless_transfer(
            DIRECT,
            value,
            np.ones(1),
            deviation,
            value(deviation),
            wanted,
            inverse,
            0.0 * u,
            point,
            np.zeros(1),
        )
    refuse_if(
        np.abs(bias).max() > TOLERANCE * (1.0 + np.abs(u).max()),
        "This law cannot hold the robot at rest there.",
        f"expected integrals that give {u.tolist()}, got {(u - bias).tolist()} at best",
        "a pose nearer to the design's, moving=True, or a Schedule with a law there",
    )
    return integrals
