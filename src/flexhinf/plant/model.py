"""Models with names: ẋ = flow(x, u, d, p), or x⁺ of a map, and y = output(x, u, p): evaluated, linearised, traced."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Self, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import Summarised, names_text
from flexhinf.numerals import number_text, power_of
from flexhinf.plant.code import StoredCode, TracedCode, has_a_name, signals
from flexhinf.plant.integration import fastest_modes
from flexhinf.plant.parameters import ParameterTable
from flexhinf.scalars import (
    digest,
    function_arrays,
    jacobian,
    pack,
    serial,
    symbols,
    trace,
)
from flexhinf.validation import (
    LONGEST_NAME,
    checked_kind,
    checked_name,
    checked_names,
    checked_text,
    distinct,
    extra_package,
    one_of,
    real_array,
    value_text,
)

#: Largest rate at an operating point, relative to the plant's own rates, that still counts as an equilibrium.
EQUILIBRIUM_TOLERANCE = 1e-9


def python_control() -> Any:
    """The package, or an error that says how to get it."""
    return extra_package("control", "control", "python-control is not installed.")


@dataclass(frozen=True, eq=False, repr=False)
class Model(Summarised):
    """Physics with named states, inputs, disturbances and parameters: a robot, or anything else.

    Parameters
    ----------
    flow : callable
        ``flow(x, u, d, p)`` → ẋ, shape (n,). NumPy code that runs on any element: numbers, symbols,
        truncated polynomials. ``p`` has the parameters as attributes. What is not smooth comes from
        `flexhinf.scalars`.
    output : callable
        ``output(x, u, p)`` → y, the measured signals, shape (p,).
    states, inputs, disturbances : sequence of str
        Names, in the order of x, u and d. A plant without inputs (a target that is tracked) has ``inputs=()``:
        estimators take it, laws and loops refuse it.
    parameters : mapping of str to float
        Nominal values, SI units.
    outputs : sequence of str, optional
        Names of the measured signals (``output_1`` … by default).
    units : mapping of str to str, optional
        Unit of each named signal, and of parameters; of an array's elements by ``name[1]``, ``name[2]``, ….
    groups : mapping of str to sequence of str, optional
        Names that stand for several signals, for example one per joint; understood by `with_objective`.
    limits : mapping of str to (float, float), optional
        Range of a state: a command beyond it is refused by `Loop.run`.
    engaged : callable, optional
        ``engaged(x, p)`` → a point near x at which everything in the flow acts, where it has a dead zone: inside
        backlash no spring is felt, and a run that leaves it is faster than its linearisation there.
    arrest : callable, optional
        ``arrest(x, h, p)`` → the state at the end of a step of h seconds after set-valued friction, which no flow
        can express, has acted on the state x that the flow reaches. Only `flexhinf.Loop` has it; linearisations and
        estimators do not.
    sampled : bool
        The plant is a map: ``flow`` returns x⁺, the state one period later with u and d held, instead of ẋ. The period
        is that of the filter or the loop that has the plant. Estimators and `flexhinf.Loop` evaluate it once a period;
        what needs ẋ refuses it.
    angles : sequence of str, optional
        States and measured signals, rad, of which whole turns mean nothing: an estimator takes differences of them by
        the shorter way round. A measurement may jump by 2π, and a map may wrap its state. Estimates go on counting
        turns, and a law reads them as they are. Names of groups stand for their signals.
    coupling : (n, n), optional
        T of a robot whose motors move more than their own joints, θ = T q: what laws and filters of pairs read.

    Raises InvalidInput: if names repeat, if a parameter is not finite, or if `flow` or `output` does not run on
    symbols of these shapes.

    Examples
    --------
    A pendulum whose angle is measured:

    >>> import flexhinf as fh
    >>> import numpy as np
    >>> plant = fh.Plant(
    ...     lambda x, u, d, p: np.array([x[1], -p.gravity * np.sin(x[0]) + u[0] + d[0]]),
    ...     lambda x, u, p: x[:1],
    ...     ("angle", "rate"), ("torque",), ("push",), {"gravity": 9.81}, outputs=("angle",),
    ... )
    >>> plant.derivative([np.pi / 2, 0.0], [0.0])
    array([ 0.  , -9.81])
    """

    flow: Callable[..., Elements]
    output: Callable[..., Elements]
    states: Sequence[str]
    inputs: Sequence[str]
    disturbances: Sequence[str] = ()
    parameters: Any = field(default_factory=dict[str, float])  # numbers by name, then their `ParameterTable`
    outputs: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    engaged: Callable[..., Elements] | None = None
    arrest: Callable[..., Elements] | None = None
    sampled: bool = False
    angles: Sequence[str] = ()
    coupling: Sequence[Sequence[float]] = ()

    def __post_init__(self) -> None:
        checked_kind(
            "Whether the plant is a map is not said.",
            self.sampled,
            bool,
            "sampled=True or sampled=False",
            "sampled=True where flow returns the state one period later",
        )
        refuse_if(
            self.sampled and self.arrest is not None,
            "A map has no friction of its own between samples.",
            "expected arrest=None with sampled=True, got both",
            "friction inside flow, or a plant in continuous time",
        )
        if not isinstance(self.parameters, ParameterTable):
            object.__setattr__(self, "parameters", ParameterTable(self.parameters))
        for kind in ("states", "inputs", "disturbances", "outputs"):
            names = checked_names(f"The {kind} of the plant", getattr(self, kind))
            distinct(f"Of the {kind} of the plant, the name", names)
            for name in names:
                checked_name(f"one of the {kind}", name, spaces=True, longest=2 * LONGEST_NAME)
            object.__setattr__(self, kind, names)
        checked_kind("The units are no mapping.", self.units, Mapping, "a dict", "units={'angle': 'rad'}")
        for name, unit in self.units.items():
            checked_text(f"the unit of {value_text(name)}", unit)
        refuse_if(
            not self.states,
            "A plant needs a state.",
            "expected at least one name, got none",
            "states=(...)",
        )
        distinct("Of states and inputs, the name", (*self.states, *self.inputs))
        refuse_if(
            self.traced_flow.size1_out(0) != len(self.states),
            f"flow(x, u, d, p) returns the wrong number of {'states' if self.sampled else 'derivatives'}.",
            f"expected {self.n}, one for each of {list(self.states)}, got {self.traced_flow.size1_out(0)}",
            "one value per state, in the order of states",
        )
        measured = self.traced_output.size1_out(0)
        if not self.outputs:
            object.__setattr__(self, "outputs", tuple(f"output_{i + 1}" for i in range(measured)))
        refuse_if(
            len(self.outputs) != measured,
            "output(x, u, p) and the names of the outputs disagree.",
            f"expected {len(self.outputs)} signals {list(self.outputs)}, got {measured}",
            "one name per signal",
        )
        object.__setattr__(self, "angles", self._checked_angles())

    def _checked_angles(self) -> tuple[str, ...]:
        angles = self.expanded(checked_names("The angles", self.angles))
        distinct("Of the angles, the name", angles)
        for name in angles:
            known = (*self.states, *self.outputs)
            one_of(f"There is no state or measured signal {name!r} that could be an angle.", name, known)
            refuse_if(
                self.unit(name) not in ("", "rad"),
                f"The angle {name!r} has another unit.",
                f"expected 'rad', in which a turn is 2π, got {self.unit(name)!r}",
                "output(x, u, p) and flow(x, u, d, p) in rad",
            )
        return angles

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    def values_texts(self, names: Sequence[str], values: ArrayLike) -> list[str]:
        """Values of signals with their names and units, but for zeros."""
        pairs = zip(names, np.asarray(values, dtype=float).tolist(), strict=True)
        return [f"{name} = {number_text(value, self.unit(name))}" for name, value in pairs if value]

    def weight_units(self, names: Sequence[str]) -> list[str]:
        """Units of weights of squares of signals in a cost without one, such as V⁻²; "" of a signal without a unit."""
        return [power_of(self.unit(name), "⁻²") for name in names]

    def weights_texts(self, names: Sequence[str], values: ArrayLike) -> list[str]:
        """Weights of squares of signals in such a cost, with their units."""
        return list(map(number_text, np.asarray(values, dtype=float).tolist(), self.weight_units(names)))

    def unit(self, name: str) -> str:
        """Unit of a named signal, empty when none was given."""
        return self.units.get(name, "")

    def index(self, name: str) -> int:
        """Place of a state in x, by name."""
        one_of(f"There is no state {name!r}.", name, self.states)
        return tuple(self.states).index(name)

    def angle_places(self, names: Sequence[str]) -> list[int]:
        """Places of the angles among names of states or outputs."""
        return [place for place, name in enumerate(names) if name in self.angles]

    def expanded(self, names: str | Sequence[str]) -> tuple[str, ...]:
        """Names of signals, with each group replaced by what it stands for."""
        named = checked_names("The signals", names)
        return tuple(single for name in named for single in self.groups.get(name, (name,)))

    @property
    def code_key(self) -> tuple[object, ...]:
        """What distinguishes this plant's code from another's (not its parameter values).

        The key depends on what the code computes: two functions that do the same share their machine code, and
        one function that reads a changed constant has another key when its plant is built anew.
        """
        shapes = tuple((name, value.shape) for name, value in self.parameters.values.items())
        arrest = () if self.arrest is None else (digest(self.traced_arrest),)
        kind = (*(("map",) if self.sampled else ()), *((("angles", self.angles),) if self.angles else ()))
        return (
            *self._content,
            *kind,
            *arrest,
            self.states,
            self.inputs,
            self.disturbances,
            self.outputs,
            shapes,
        )

    @cached_property
    def _content(self) -> tuple[str, str]:
        return digest(self.traced_flow), digest(self.traced_output)

    def check_unchanged(self) -> None:
        """Refuse code that no longer computes what it did when the plant was built.

        Numbers, derivatives and machine code are those of the flow as it was traced then. This is called before its
        text runs again, so that two models are never mixed.
        """
        if isinstance(self.flow, StoredCode):
            return
        arguments, columns = self._flow_symbols
        text = serial(columns, self._flow_text(*arguments))
        if text in self._known_texts:  # as it was when it was traced: half the work of a trace
            return
        refuse_if(
            digest(self._trace_flow()) != self._content[0],
            "flow(x, u, d, p) computes something else than when its plant was built.",
            "expected the same operations and constants: a global or an attribute that it reads has changed",
            "build the plant anew, or make what changes a parameter: plant.with_parameters(name=value)",
        )
        self._known_texts.add(text)

    @cached_property
    def _known_texts(self) -> set[str]:  # of the flow, that compute what was traced
        return set()

    @cached_property
    def _flow_symbols(self) -> tuple[list[Elements], list[ca.SX]]:  # as arrays and as columns
        arrays = [symbols(name, size) for name, size in zip("xudp", self._sizes)]
        return arrays, [pack(array) for array in arrays]

    def with_parameters(self, **changes: ArrayLike) -> Self:
        """The same plant with other parameter values; nothing is traced or compiled again."""
        changed = copy.copy(self)
        object.__setattr__(changed, "parameters", self.parameters.replaced(changes))
        return changed

    # Copies and pickles ---------------------------------------------------------------------------
    def __copy__(self) -> Self:
        same = object.__new__(type(self))
        vars(same).update(self.__dict__)
        return same

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        same = object.__new__(type(self))
        vars(same).update(copy.deepcopy(self.__dict__, memo))
        return same

    def __getstate__(self) -> dict[str, object]:
        """For a pickle: the plant as it was traced, wherever it is read, whatever its text would compute there.

        Code without a name to be found by, such as a lambda, becomes its instructions; of other code the text is
        found again, for expansions, which ask `check_unchanged`.
        """
        state = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        for name, traced in (("flow", self.traced_flow), ("output", self.traced_output)):
            if not has_a_name(state[name]):
                state[name] = StoredCode(function_arrays(traced), self.parameters)
        return state | {name: getattr(self, name) for name in ("traced_flow", "traced_output", "_content")}

    def to_control(self, x: ArrayLike | None = None, u: ArrayLike | None = None) -> Any:
        """As a system of python-control: inputs and disturbances in, measured signals out. Needs the extra ``control``.

        Parameters
        ----------
        x, u : (n,) and (m,) arrays, optional
            With one of them, linearised there (``ss`` with D, in deviations); without, nonlinear (``nlsys``). A map
            is a system with ``dt=True``; it is linearised at an equilibrium.
        """
        names = {
            "inputs": [*self.inputs, *self.disturbances],
            "outputs": [*self.outputs],
            "states": [*self.states],
            **({"dt": True} if self.sampled else {}),
        }
        p, m = self.parameters.vector(), len(self.inputs)

        def rates(t: float, x: np.ndarray, v: np.ndarray, params: object) -> np.ndarray:
            return np.ravel(np.asarray(self.traced_flow(x, v[:m], v[m:], p), dtype=float))

        def measured(t: float, x: np.ndarray, v: np.ndarray, params: object) -> np.ndarray:
            return np.ravel(np.asarray(self.traced_output(x, v[:m], p), dtype=float))

        if x is None and u is None:
            return python_control().nlsys(rates, measured, **names)
        at, held, _ = (rows[0] for rows in self._points(x, u, single=True))
        a, b, g, c = self.slopes(at, held)
        d = np.hstack([self.output_at(at, held)[1], np.zeros((len(c), g.shape[1]))])
        return python_control().ss(a, np.hstack([b, g]), c, d, **names)

    def output_at(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y at (x, u), and ∂y/∂u there, exactly."""
        p = self.parameters.vector()

        def output(u: Elements, x: Elements, p: Elements) -> Elements:
            return self.evaluate_output(x, u, p)

        return jacobian(output, len(self.inputs), self.n, len(p), name="output")(u, x, p)

    def check_equilibrium(self, x: np.ndarray, u: np.ndarray, what: str, advice: str) -> None:
        """Refuse a point at which a rate is not zero, relative to the plant's own rates."""
        rate = self.change(x, u)
        worst = int(np.argmax(np.abs(rate)))
        largest = (
            EQUILIBRIUM_TOLERANCE * max(1.0, self.fastest_mode(x, u)) if np.isfinite(rate).all() else -1.0
        )
        refuse_if(
            not abs(rate[worst]) <= largest,
            what,
            f"expected {self.equilibrium_text}, got {self.change_text(worst)} = {rate[worst]:.6g}",
            advice,
        )

    def summary(self) -> dict[str, str]:
        """States, inputs, disturbances, measured signals and parameters, for ``repr``."""
        named = {kind: getattr(self, kind) for kind in ("states", "inputs", "disturbances")}
        named |= {"measured": self.outputs, "parameters": self.parameters.names}
        kind = {"time": "sampled: a map of one period"} if self.sampled else {}
        return kind | {name: names_text(names) for name, names in named.items()}

    # Numbers --------------------------------------------------------------------------------------
    @cached_property
    def traced_flow(self) -> ca.Function:
        """flow as a CasADi function of (x, u, d, parameter vector), as it is when the plant is built."""
        return self._trace_flow()

    def _trace_flow(self) -> ca.Function:
        return trace(self._flow_text, *self._sizes, name="flow", names=("x", "u", "d", "p"))

    @property
    def _sizes(self) -> tuple[int, ...]:
        return len(self.states), len(self.inputs), len(self.disturbances), self.parameters.size

    def _flow_text(self, x: Elements, u: Elements, d: Elements, p: Elements) -> np.ndarray:
        return signals("flow(x, u, d, p)", lambda: self.flow(x, u, d, self.parameters.named(p)))

    @cached_property
    def traced_output(self) -> ca.Function:
        """output as a CasADi function of (x, u, parameter vector)."""

        def output(x: Elements, u: Elements, p: Elements) -> Elements:
            return signals("output(x, u, p)", lambda: self._output_text(x, u, p))

        sizes = len(self.states), len(self.inputs), self.parameters.size
        return trace(output, *sizes, name="output", names=("x", "u", "p"))

    def _output_text(self, x: Elements, u: Elements, p: Elements) -> Elements:
        return np.atleast_1d(self.output(x, u, self.parameters.named(p)))

    @cached_property
    def traced_arrest(self) -> ca.Function:
        """arrest as a CasADi function of (x, (h,), parameter vector)."""
        arrest, named = cast(Callable[..., Elements], self.arrest), self.parameters.named

        def stopped(x: Elements, h: Elements, p: Elements) -> Elements:
            return arrest(x, h[0], named(p))

        sizes = len(self.states), 1, self.parameters.size
        return trace(stopped, *sizes, name="arrest", names=("x", "h", "p"))

    @cached_property
    def _codes(self) -> tuple[TracedCode, TracedCode]:
        return TracedCode(self.traced_flow), TracedCode(self.traced_output)

    def evaluate_flow(self, x: Elements, u: Elements, d: Elements, p: Elements) -> Elements:
        """ẋ, or x⁺ of a map, (n,) on any element, p the parameter vector.

        Numbers and symbols go through what was traced, as all machine code does; other elements through the text.
        """
        rates = self._codes[0].evaluate(x, u, d, p)
        return self.flow(x, u, d, self.parameters.named(p)) if rates is None else rates

    def evaluate_output(self, x: Elements, u: Elements, p: Elements) -> Elements:
        """y (p,) on any element, as `evaluate_flow`."""
        y = self._codes[1].evaluate(x, u, p)
        return self._output_text(x, u, p) if y is None else y

    @cached_property
    def traced_jacobians(self) -> ca.Function:
        """A = ∂flow/∂x, B = ∂flow/∂u, G = ∂flow/∂d, C = ∂output/∂x as one CasADi function."""
        symbols = [ca.SX.sym(name, self.traced_flow.size1_in(k)) for k, name in enumerate("xudp")]
        x, u, d, p = symbols
        flow, output = self.traced_flow(*symbols), self.traced_output(x, u, p)
        results = [ca.jacobian(flow, v) for v in (x, u, d)] + [ca.jacobian(output, x)]
        return ca.Function("jacobians", symbols, [ca.densify(r) for r in results], {"cse": True})

    def trace_jacobians(self) -> ca.Function:
        """Trace the Jacobians now: plants that `with_parameters` makes from this one share them."""
        return self.traced_jacobians

    def derivative(
        self, x: ArrayLike | None = None, u: ArrayLike | None = None, d: ArrayLike | None = None
    ) -> np.ndarray:
        """ẋ at the nominal parameters; x (n,) or (N, n), u (m,) or (N, m), d likewise; zero by default.

        A map has none, and is refused.
        """
        self.check_continuous("derivative")
        return self.change(x, u, d)

    def change(
        self, x: ArrayLike | None = None, u: ArrayLike | None = None, d: ArrayLike | None = None
    ) -> np.ndarray:
        """ẋ, or x⁺ − x of a map: what is zero at rest; arguments as of `derivative`."""
        points = self._points(x, u, d)
        count = max(map(len, points)) if all(map(len, points)) else 0
        if any(len(rows) not in (1, count) for rows in points):
            raise InvalidInput(
                "The numbers of points differ.",
                f"got {[len(rows) for rows in points]} rows of x, u and d",
                "a row for each point, or one for all",
            )
        if not count:  # to CasADi, a matrix without columns is a zero
            return np.zeros((0, self.n))
        vector = self.parameters.vector()
        if count == 1:  # every run asks for one
            at, held, load = (rows[0] for rows in points)
            result = self.evaluate_flow(at, held, load, vector)[None]
        else:
            columns = [np.broadcast_to(rows, (count, rows.shape[1])).T for rows in points]
            result = np.asarray(self.traced_flow(*columns, vector), dtype=float).T
        result = result - points[0] if self.sampled else result
        several = any(value is not None and np.ndim(value) == 2 for value in (x, u, d))
        return result if several else result[0]

    def linearise(
        self, x: ArrayLike | None = None, u: ArrayLike | None = None, d: ArrayLike | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(A, B, G, C): exact Jacobians of flow in x, u, d, and of output in x, at one point, zero by default.

        A map has another meaning of A, and is refused: its Jacobians are `slopes`.
        """
        self.check_continuous("linearisation in continuous time")
        return self.slopes(x, u, d)

    def slopes(
        self, x: ArrayLike | None = None, u: ArrayLike | None = None, d: ArrayLike | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """As `linearise`, of a map too: ∂x⁺/∂x, ∂x⁺/∂u, ∂x⁺/∂d and ∂y/∂x."""
        points = [rows[0] for rows in self._points(x, u, d, single=True)]
        matrices = cast(Sequence[ca.DM], self.traced_jacobians(*points, self.parameters.vector()))
        a, b, g, c = (np.asarray(matrix, dtype=float) for matrix in matrices)
        return a, b, g, c

    def change_slopes(
        self, x: ArrayLike | None = None, u: ArrayLike | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Exact Jacobians of `change` in x, u and d, at one point, zero by default."""
        a, b, g, _ = self.slopes(x, u)
        return (a - np.eye(self.n) if self.sampled else a), b, g

    @property
    def equilibrium_text(self) -> str:
        """The condition of rest, for messages."""
        return "x⁺ = x" if self.sampled else "flow = 0"

    def change_text(self, state: int) -> str:
        """Name of an element of `change`, for messages."""
        return f"{'change of' if self.sampled else 'd/dt'} {self.states[state]}"

    def check_continuous(self, what: str) -> None:
        """Refuse a map, of which there is no such thing as `what`."""
        refuse_if(
            self.sampled,
            f"A map has no {what}.",
            "expected a plant in continuous time, flow(x, u, d, p) = ẋ, got one with sampled=True",
            "the plant in continuous time; a map is for estimators and as the true plant of a Loop",
        )

    def check_driven(self, what: str) -> None:
        """Refuse a plant without inputs, for which there is no such thing as `what`."""
        refuse_if(
            not self.inputs,
            f"A plant without inputs has no {what}.",
            "expected at least one input, got inputs=()",
            "inputs=(...); a plant without inputs is for estimators",
        )

    def fastest_mode(self, x: ArrayLike | None = None, u: ArrayLike | None = None) -> float:
        """Largest |eigenvalue| of ∂flow/∂x at a point (the origin by default) and where it is engaged, rad/s; 0 of a
        map, which nothing has to follow between samples."""
        x, u, _ = (rows[0] for rows in self._points(x, u, single=True))
        return float(fastest_modes(self, self.parameters.vector()[None], x, u)[0])

    def _points(
        self, x: ArrayLike | None, u: ArrayLike | None, d: ArrayLike | None = None, single: bool = False
    ) -> list[np.ndarray]:
        """Rows of numbers for x, u and d, (N, n), (N, m) and (N, k); zeros for None."""
        points: list[np.ndarray] = []
        for letter, value, names in zip("xud", (x, u, d), (self.states, self.inputs, self.disturbances)):
            rows = np.atleast_2d(np.zeros(len(names)) if value is None else real_array(value))
            fits = rows.ndim == 2 and rows.shape[1] == len(names) and (not single or len(rows) == 1)
            if not fits or not np.isfinite(rows).all():
                raise InvalidInput(
                    f"The point {letter} does not fit the plant.",
                    f"expected {len(names)} finite numbers for {list(names)}, got {value_text(value)}",
                    "one number per name" + ("" if single else ", or one row of them for each point"),
                )
            points.append(rows)
        return points
