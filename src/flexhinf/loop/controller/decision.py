"""The decision of a protective stop after each step of a controller, compiled.

It is that of the exported C, see `flexhinf.loop.controller.stop`.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program
from flexhinf.codegen.shared import share
from flexhinf.errors import FlexhinfError
from flexhinf.loop.controller.slowing import voters_of
from flexhinf.loop.controller.stop import StopState, decision, first_stop, reasons, stop_numbers, stop_state
from flexhinf.plant.plant import equilibrium_at

#: What the compiled decision reads, and what it writes.
READ, WRITTEN = ("kept", "flags", "u", "hold", "readings", "category", "data"), ("acts", "after")


class Decision:
    """What decides after each step of a controller, on the memory of its last sample."""

    def __init__(self, controller: Any, history: Any) -> None:
        self._controller, self._history, protection = controller, history, controller.protection
        traced = share(("traced decision", key := decision_key(controller)), lambda: decision(controller))
        sizes = [traced.size1_in(k) for k in range(traced.n_in())] + [traced.size1_out(k) for k in range(2)]
        self._arrays = {name: np.zeros(size) for name, size in zip((*READ, *WRITTEN), sizes, strict=True)}
        places = controller.memory.places
        self._arrays |= {"u": history.memory[places["u"]], "data": controller.data_vector.copy()}
        if protection is not None:
            self._arrays |= {"readings": history.memory[places["readings"]]}
            self._arrays["category"][0] = protection.category
        kernel = share(("decision", key), lambda: compile_program(_program(traced)))
        self._run = kernel.bind(self._arrays, {}, short=True)

    def __call__(self) -> StopState:
        """What is remembered after the last step, and what acts."""
        history, arrays = self._history, self._arrays
        kept: StopState = history.stop or first_stop(arrays["u"])
        arrays["flags"][:] = reasons(self._controller, history)
        arrays["kept"][:] = np.concatenate(kept)
        arrays["hold"][:] = (
            self._hold(kept) if arrays["flags"].any() and not kept.reasons.any() else kept.last
        )
        self._run()
        return stop_state(arrays["after"].copy(), len(arrays["u"]))

    def _hold(self, kept: StopState) -> Vector:
        """The inputs (m,) that hold the model at a moving command where a stop begins; what acted, where that has no
        equilibrium."""
        c, m = self._controller, len(kept.last)
        model = None if c.estimator is None else c.estimator.plant
        if model is not None and c.mode.moving:
            tracked = [c.states.index(name) for name in c.tracked]
            pose = self._history.memory[c.memory.places["reference"]][tracked]
            with suppress(FlexhinfError):
                return equilibrium_at(model, c.tracked, pose)[1][:m]
        return np.array(kept.last)


def decision_key(controller: Any) -> tuple[object, ...]:
    """Key of the compiled decision: equal for controllers of which it has the same numbers."""
    drive, numbers = stop_numbers(controller)
    parts: tuple[Any, ...] = numbers.damping, *numbers.masses
    constants = [np.asarray(part, dtype=float).tobytes() for part in parts]
    return controller.code_key, drive, controller.protection is not None, voters_of(controller), *constants


def _program(traced: Any) -> Program:
    """The decision over one buffer for each argument and result."""
    sizes = {name: traced.size1_in(k) for k, name in enumerate(READ)}
    results = {name: traced.size1_out(k) for k, name in enumerate(WRITTEN)}
    buffers = [Buffer(name, size, "in") for name, size in sizes.items()]
    buffers += [Buffer(name, size, "out") for name, size in results.items()]
    inputs, outputs = (
        tuple(Slice(name, size=size) for name, size in part.items()) for part in (sizes, results)
    )
    return Program("decision", tuple(buffers), (Call(traced, inputs, outputs),))
