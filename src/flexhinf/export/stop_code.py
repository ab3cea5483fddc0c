"""The decision whether a controller's output may act, as values of C templates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from markupsafe import Markup

from flexhinf.codegen.c import Real, Translator, constant
from flexhinf.loop.controller.signs import SIGNS
from flexhinf.loop.controller.starting import is_checkable, look_samples
from flexhinf.loop.controller.stop import FAILED, StopState, decision, first_stop, possible_stops, stop_size
from flexhinf.stops import Stop

if TYPE_CHECKING:
    import casadi

    from flexhinf.loop import Controller

#: Arguments and results of `StopCode.deciding` in C.
DECIDING = ("before", "reasons", "u", "hold", "readings", "category", "data", "acts", "after")


class Coded(Protocol):
    """What of a controller's code the decision needs, see `flexhinf.export.controller_c.ControllerCode`."""

    @property
    def real(self) -> Real: ...  # noqa: D102
    @property
    def controller(self) -> Controller: ...  # noqa: D102
    @property
    def signals(self) -> Mapping[str, Any]: ...  # noqa: D102
    @property
    def sizes(self) -> Mapping[str, int]: ...  # noqa: D102
    @property
    def translator(self) -> Translator: ...  # noqa: D102
    @property
    def standstill(self) -> casadi.Function | None: ...  # noqa: D102
    @property
    def whole_numbers(self) -> tuple[int, int, int]: ...  # noqa: D102
    @property
    def codes(self) -> Mapping[str, Any]: ...  # noqa: D102
    def numbers(self, values: Sequence[float] | np.ndarray) -> Markup: ...  # noqa: D102
    def upper(self, what: str) -> str: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class StopCode:
    """The decision of a controller's code."""

    code: Coded

    @property
    def stop_text(self) -> str:
        """What acts without power, for a header."""
        protection = self.code.controller.protection
        held = protection is not None and protection.drive == "position"
        return "the last one" if held else "0 as far as its limits allow"

    @property
    def is_checkable(self) -> bool:
        """Whether each motor's encoder has a second reading that tells whether its place is true."""
        return is_checkable(self.code.controller)

    @property
    def starting(self) -> dict[str, object]:
        """What ``NAME_at_rest`` consists of: how far readings may move, and twists of springs, as measured and of the
        model at rest at the measured links."""
        c, real = self.code.controller, self.code.real
        protection, watch = c.protection, c.mode.protected
        samples = look_samples(c.period)
        if protection is None or watch is None:
            return {"samples": samples, "pairs": ()}
        states, links = (
            list(self.code.signals["X"]),
            [list(c.measured).index(name) for name in protection.links],
        )
        pairs = list[dict[str, object]]()
        for j, pair in enumerate(watch.pairs if links and self.code.standstill is not None else ()):
            terms = [(constant(protection.shares[row][j], real), place) for place, row in pair.links]
            model = [f"{share} * rest[{states.index(c.measured[place])}]" for share, place in terms]
            seen = [f"{share} * y[{place}]" for share, place in terms]
            pairs.append({
                "measured": Markup(" - ".join([f"y[{pair.motor}]", *seen])),
                "model": Markup(" - ".join([f"rest[{states.index(c.measured[pair.motor])}]", *model])),
                "most": Markup(constant(protection.twist_at_start[j], real)),
            })  # fmt: skip
        moved = Markup(", ".join(constant(way, real) for way in protection.moved_at_start))
        return {"samples": samples, "pairs": pairs, "links": links, "moved": moved}

    @property
    def reasons(self) -> tuple[Stop, ...]:
        """Reasons that may stop the robot."""
        return possible_stops(self.code.controller)

    @cached_property
    def deciding(self) -> casadi.Function:
        """(what a stop remembers, reasons, u, what holds the robot, readings, category, parameters) → the input that
        acts, and what is remembered then, as a CasADi function."""
        return decision(self.code.controller)

    @property
    def deciding_values(self) -> dict[str, object]:
        """What ``NAME_may_act`` consists of."""
        c = self.code.controller
        first = first_stop(np.asarray(c.input_before()))
        _, stop_on, category = self.code.whole_numbers
        return {
            "stop_size": stop_size(self.code.sizes["u"]),
            "stop_last": sum(np.size(part) for part in first[: StopState._fields.index("last")]),
            "initial_stop": self.code.numbers(np.concatenate(first)),
            "stop_on": stop_on,
            "category": category,
            "reasons": list(Stop),
            "fails": Markup(
                " || ".join(f"code == {self.code.upper(name)}" for name in FAILED if name in self.code.codes)
            ),
            "signs": len(SIGNS) if c.protection else 0,
            "decided": self.code.translator.function(
                self.deciding, *DECIDING, within={6: ("data", 0)}, apart=True
            ),
        }
