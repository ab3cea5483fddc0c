"""Where a name stands among the signals of a loop."""

from __future__ import annotations

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.simulation.metrics import Place
from flexhinf.plant import Plant


def signal_names(plant: Plant, controller: Controller) -> dict[str, tuple[str, ...]]:
    """Names of the columns of each kind of signal of a loop."""
    return {
        "state": tuple(plant.states),
        "output": tuple(controller.measured),
        "estimate": tuple(controller.estimated),
        "input": tuple(controller.law.input_names),
    }


def tracked_place(plant: Plant, controller: Controller, name: str) -> Place:
    """Signal and columns of a tracked state, chosen as in `Trajectory.tracked`."""
    names = signal_names(plant, controller)
    kind = next((kind for kind in ("state", "output", "estimate") if name in names[kind]), "state")
    return Place(kind, names[kind].index(name), controller.commanded.index(name))


def signal_place(plant: Plant, controller: Controller, text: str) -> tuple[str, int]:
    """Kind and column of a signal that is kept, see `Loop.ensemble`."""
    names = signal_names(plant, controller)
    kind, _, name = text.rpartition(".")
    for candidate in [kind] if kind in names else ["state", "output"]:
        if name in names[candidate]:
            return candidate, names[candidate].index(name)
    raise InvalidInput(
        f"There is no signal {text!r}.",
        f"expected states and measured signals out of {[*plant.states, *controller.measured]}",
        f"one of these, or estimate.{controller.states[0]}, or input.{names['input'][0]}",
    )
