"""Physics: ẋ = flow(x, u, d, p), y = output(x, u, p), as ordinary NumPy code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.parameters import ParameterTable

if TYPE_CHECKING:
    from flexhinf.plant.generalised import GeneralisedPlant
    from flexhinf.plant.penalty import Penalty

__all__ = ["Plant"]


@dataclass(frozen=True, eq=False)
class Plant:
    """A system with named states, inputs, disturbances and parameters.

    Parameters
    ----------
    flow : callable
        ``flow(x, u, d, p)`` → ẋ, shape (n,). NumPy code that runs on any element: numbers, symbols, truncated
        polynomials. ``p`` has the parameters as attributes. What is not smooth comes from `flexhinf.scalars`.
    output : callable
        ``output(x, u, p)`` → y, the measured signals.
    states, inputs, disturbances : sequence of str
        Names, in the order of x, u and d.
    parameters : mapping of str to float
        Nominal values, SI units.
    outputs : sequence of str, optional
        Names of the measured signals (``output_1`` … by default).
    units : mapping of str to str, optional
        Unit of each named signal.

    Raises
    ------
    InvalidInput
        If names repeat, if a parameter is not finite, or if `flow` or `output` does not run on symbols with these shapes.
    """

    flow: Callable[..., Any]
    output: Callable[..., Any]
    states: Sequence[str]
    inputs: Sequence[str]
    disturbances: Sequence[str] = ()
    parameters: Any = field(default_factory=dict)
    outputs: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.parameters, ParameterTable):
            object.__setattr__(self, "parameters", ParameterTable(dict(self.parameters)))
        for kind in ("states", "inputs", "disturbances", "outputs"):
            names = getattr(self, kind)
            names = (names,) if isinstance(names, str) else tuple(names)
            if len(set(names)) != len(names):
                raise InvalidInput(
                    f"Two {kind} of the plant have the same name.", f"got {list(names)}", "distinct names"
                )
            object.__setattr__(self, kind, names)
        if not self.states or not self.inputs:
            raise InvalidInput(
                "A plant needs at least one state and one input.",
                f"got {len(self.states)} states and {len(self.inputs)} inputs",
                "states=(...), inputs=(...)",
            )
        rows = self._probe("flow", len(self.states))
        if rows != len(self.states):
            raise InvalidInput(
                "flow(x, u, d, p) returns the wrong number of derivatives.",
                f"expected {len(self.states)}, one for each of {list(self.states)}, got {rows}",
                "one derivative per state, in the order of states",
            )
        measured = self._probe("output", None)
        if not self.outputs:
            object.__setattr__(self, "outputs", tuple(f"output_{i + 1}" for i in range(measured)))
        if len(self.outputs) != measured:
            raise InvalidInput(
                "output(x, u, p) and the names of the outputs disagree.",
                f"expected {len(self.outputs)} signals {list(self.outputs)}, got {measured}",
                "one name per signal",
            )

    def _probe(self, which: str, rows: int | None) -> int:
        """How many signals `flow` or `output` returns, found by running it once on symbols."""
        traced = self.traced_flow if which == "flow" else self.traced_output
        if traced.n_out() != 1:
            raise InvalidInput(
                f"{which} returns several arrays.",
                f"expected one array of {rows or 'the'} signals",
                "np.array([...])",
            )
        return traced.size1_out(0)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    def unit(self, name: str) -> str:
        """Unit of a named signal, empty when none was given."""
        return self.units.get(name, "")

    def index(self, name: str) -> int:
        """Place of a state in x, by name."""
        if name not in self.states:
            raise InvalidInput(
                f"There is no state {name!r}.", f"expected one of {list(self.states)}", "one of these names"
            )
        return tuple(self.states).index(name)

    @property
    def code_key(self) -> tuple[object, ...]:
        """What distinguishes this plant's code from another's (not its parameter values)."""
        shapes = tuple((name, value.shape) for name, value in self.parameters.values.items())
        return (self.flow, self.output, self.states, self.inputs, self.disturbances, self.outputs, shapes)

    def with_parameters(self, **changes: Any) -> Plant:
        """The same plant with other parameter values; nothing is compiled again."""
        changed = replace(self, parameters=self.parameters.replaced(changes))
        for cached in ("traced_flow", "traced_output", "traced_jacobians"):
            if cached in self.__dict__:
                changed.__dict__[cached] = self.__dict__[cached]
        return changed

    def with_objective(
        self,
        penalty: Penalty | Mapping[str, float] | Sequence[float],
        command: str | None = None,
        integrate: Sequence[str] = (),
        pose: Any = None,
        disturbances: Sequence[str] | None = None,
    ) -> GeneralisedPlant:
        """The problem of Eq. (3): this plant with a penalty, integrals of the tracking error and disturbance channels.

        See `flexhinf.plant.generalised.GeneralisedPlant` for the arguments.
        """
        from flexhinf.plant.generalised import GeneralisedPlant
        from flexhinf.plant.penalty import Penalty

        integrate = (integrate,) if isinstance(integrate, str) else tuple(integrate)
        return GeneralisedPlant(self, Penalty.of(penalty), integrate, command, disturbances, pose)

    # Numbers --------------------------------------------------------------------------------------------------
    @cached_property
    def traced_flow(self) -> Any:
        """flow as a CasADi function of (x, u, d, parameter vector)."""
        from flexhinf.scalars import trace

        sizes = (len(self.states), len(self.inputs), len(self.disturbances), self.parameters.size)
        return trace(
            lambda x, u, d, p: np.asarray(self.flow(x, u, d, self.parameters.named(p)), dtype=object),
            *sizes, name="flow", names=("x", "u", "d", "p"),
        )  # fmt: skip

    @cached_property
    def traced_output(self) -> Any:
        """output as a CasADi function of (x, u, parameter vector)."""
        from flexhinf.scalars import trace

        sizes = (len(self.states), len(self.inputs), self.parameters.size)
        return trace(
            lambda x, u, p: np.atleast_1d(np.asarray(self.output(x, u, self.parameters.named(p)), dtype=object)),
            *sizes, name="output", names=("x", "u", "p"),
        )  # fmt: skip

    @cached_property
    def traced_jacobians(self) -> Any:
        """A = ∂flow/∂x, B = ∂flow/∂u, G = ∂flow/∂d, C = ∂output/∂x as one CasADi function."""
        import casadi as ca

        symbols = [ca.SX.sym(name, self.traced_flow.size1_in(k)) for k, name in enumerate("xudp")]
        x, u, d, p = symbols
        flow, output = self.traced_flow(*symbols), self.traced_output(x, u, p)
        results = [ca.jacobian(flow, v) for v in (x, u, d)] + [ca.jacobian(output, x)]
        return ca.Function("jacobians", symbols, [ca.densify(r) for r in results], {"cse": True})

    def derivative(self, x: Any, u: Any = None, d: Any = None) -> np.ndarray:
        """ẋ at the nominal parameters; x (n,) or (N, n), u (m,) or (N, m), d likewise (zero by default)."""
        points = np.atleast_2d(np.asarray(x, dtype=float))
        wide = [
            np.broadcast_to(np.zeros(size) if v is None else np.asarray(v, dtype=float), (len(points), size))
            for v, size in ((u, len(self.inputs)), (d, len(self.disturbances)))
        ]
        vector = np.broadcast_to(self.parameters.vector(), (len(points), self.parameters.size))
        result = np.asarray(self.traced_flow(points.T, wide[0].T, wide[1].T, vector.T), dtype=float).T
        return result[0] if np.ndim(x) == 1 else result

    def linearise(
        self, x: Any, u: Any = None, d: Any = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(A, B, G, C): exact Jacobians of flow in x, u, d, and of output in x, at one point."""
        zeros = [np.zeros(len(names)) for names in (self.inputs, self.disturbances)]
        arguments = (x, zeros[0] if u is None else u, zeros[1] if d is None else d, self.parameters.vector())
        results = self.traced_jacobians(*[np.asarray(a, dtype=float) for a in arguments])
        a, b, g, c = (np.asarray(r, dtype=float) for r in results)
        return a, b, g, c

    def fastest_mode(self, x: Any = None, u: Any = None) -> float:
        """Largest |eigenvalue| of ∂flow/∂x at a point (the origin by default), rad/s."""
        a = self.linearise(np.zeros(self.n) if x is None else x, u)[0]
        return float(np.abs(np.linalg.eigvals(a)).max())
