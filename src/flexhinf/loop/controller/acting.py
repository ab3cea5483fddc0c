"""The part of a controller that says whether it may begin, and whether its output may act."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.arrays import Numbers
from flexhinf.errors import refuse_if
from flexhinf.loop.controller.decision import Decision
from flexhinf.loop.controller.starting import StartCheck
from flexhinf.starts import Start
from flexhinf.stops import Stop
from flexhinf.validation import real_array, value_text

if TYPE_CHECKING:
    from flexhinf.loop.controller.memory import StateHistory, VectorLayout
    from flexhinf.loop.controller.protection import Protection


class Acting:
    """What a controller lets act, by its memory after each step."""

    measured: tuple[str, ...]
    protection: Protection | None
    gaps: bool
    _history: StateHistory
    _y: np.ndarray
    memory: cached_property[VectorLayout]

    @cached_property
    def _decision(self) -> Decision:
        return Decision(self, self._history)

    @cached_property
    def _start_check(self) -> StartCheck:
        return StartCheck(self)

    def may_act(self) -> bool:
        """Whether the drives may have power, to be asked after each step, also one that raised, and obeyed: then
        `output` is what acts. A reason that was there once, see `stop`, stays until `reset`; steps go on as before. It
        is the decision of the exported C, see `flexhinf.loop.controller.stop`."""
        history = self._history
        if self.protection is None and self.gaps:
            history.count_unseen(self._y)
        history.stop = self._decision()
        return bool(history.stop.power[0] > 0.0)

    @property
    def stop(self) -> Stop:
        """Why the drives may not act any more, since `reset`."""
        kept = self._history.stop
        return Stop(0 if kept is None else sum(one for one, flag in zip(Stop, kept.reasons) if flag > 0.0))

    @property
    def output(self) -> np.ndarray:
        """The input (m,) that acts after `may_act`: that of the last step, of a controlled stop, or without power."""
        kept = self._history.stop
        return self._history.memory[self.memory.places["u"]].copy() if kept is None else np.array(kept.last)

    def at_rest(self, y: Numbers) -> bool:
        """Whether the robot rests where the controller can begin, to be asked once a sample before the start, with what
        is measured (p,), drives off: True after 50 ms of readings that agree. `start_reasons` says what speaks against
        it, or what nothing tells. It begins anew with `reset`, a missing reading and a bad one. It is the check of the
        exported C, see `flexhinf.loop.controller.starting`.

        Raises
        ------
        InvalidInput
            If y does not have the right size.
        """
        numbers = np.full(len(self.measured), np.nan) if y is None else np.ravel(real_array(y))
        refuse_if(
            len(numbers) != len(self.measured),
            "The measurement does not fit.",
            f"expected one number for each of {list(self.measured)}, got {value_text(y)}",
            "an array of this length, NaN for an element that is missing",
        )
        rests, self._history.resting = self._start_check.after(self._history.resting, numbers)
        return rests

    @property
    def start_reasons(self) -> Start:
        """What the last `at_rest` found, since `reset`."""
        return self._history.resting.why
