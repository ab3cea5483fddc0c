"""A plant, its equilibria and its linearisation, and the problem of Eq. (3) that an objective makes of it.

ẋ = f(x) + g1(x) d + g2(x) u, z = (h(x), l(x) u), about an operating point. Systems of python-control as plants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.notebook import Summarised, names_text
from flexhinf.plant.augmented import augmented_plant
from flexhinf.plant.code import StoredCode, TracedCode, signals
from flexhinf.plant.expansion import expand_problem
from flexhinf.plant.model import EQUILIBRIUM_TOLERANCE, Model, python_control
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.penalty import Penalty
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.scalars import apply, digest, pack, symbols, trace
from flexhinf.validation import (
    checked_array,
    checked_kind,
    checked_names,
    distinct,
    read_only,
    real_array,
    unknown_name,
    value_text,
)


@dataclass(frozen=True, eq=False, repr=False)
class Plant(Model):
    """Physics with named states, inputs, disturbances and parameters: a robot, or anything else."""

    def with_objective(
        self,
        penalty: Penalty | Mapping[str, float] | Sequence[float],
        command: str | None = None,
        integrate: Sequence[str] = (),
        pose: Mapping[str, float] | ArrayLike | None = None,
        disturbances: Sequence[str] | None = None,
        equilibrium: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> GeneralisedPlant:
        """The problem of Eq. (3): this plant with a penalty, integrals of the tracking error, disturbances.

        See `GeneralisedPlant` for the arguments. The name of a group stands for all
        its signals, in the penalty (with one weight for all, or one each) as in the other arguments.
        """
        return GeneralisedPlant(
            self,
            Penalty.of(penalty).expanded(self.groups),
            self.expanded(integrate),
            command,
            None if disturbances is None else self.expanded(disturbances),
            pose,
            equilibrium,
        )

    def augmented(
        self,
        parameters: Sequence[str] = (),
        disturbances: str | Sequence[str] = (),
        offsets: str | Sequence[str] = (),
    ) -> Plant:
        """This plant with more states behind its own, for an estimator that estimates more than the state.

        The new states are constant but for the process noise that the estimator adds to them. A `Controller` takes such
        an estimator for a law of this plant: the law reads its own states.

        Parameters
        ----------
        parameters : sequence of str
            Parameters that become states of their own names (``NAME_1`` … of an array), and are no parameters any more.
        disturbances : str or sequence of str
            Channels, or groups of them, of which a constant part becomes a state of the same name.
        offsets : str or sequence of str
            Measured signals, or groups of them, of which an offset becomes a state ``NAME_offset``.

        Raises
        ------
        InvalidInput
            If there is no such parameter, disturbance or measured signal, or nothing is named.

        Examples
        --------
        A load on the link, estimated from the motor's encoder alone; R^v lets it drift by 0.05 N·m a sample.

        >>> import flexhinf as fh
        >>> plant = fh.load_robot("paper").plant(("motor_position",)).augmented(disturbances=("link_torque",))
        >>> plant.states[4:]
        ('link_torque',)
        >>> noise = [1e-10, 1e-8, 1e-10, 1e-8, 0.05**2]
        >>> ukf = fh.UnscentedKalmanFilter(plant, 1e-3, noise, 1e-8, [0.0] * 5, [1e-6, 1e-4, 1e-6, 1e-4, 1.0])
        """
        return augmented_plant(self, parameters, disturbances, offsets)


Plant.__doc__ = Model.__doc__  # with all arguments, for help(flexhinf.Plant)


@dataclass(frozen=True, eq=False, repr=False)
class GeneralisedPlant(Summarised):
    """A plant with integrals of the tracking error, a penalty and disturbance channels.

    Parameters
    ----------
    plant : Plant
        The physics, at its nominal parameters.
    penalty : Penalty
        Eq. (11) for the paper's arm. Acts on deviations from the operating point.
    integrate : sequence of str
        States whose tracking error is integrated: ė = x_i − x_d. The integrals become the last states, named
        ``NAME_integral``.
    command : {"disturbance", None}
        With "disturbance" the command x_d enters as the disturbance of the synthesis by ė: the paper's g1.
    disturbances : sequence of str, optional
        Channels of the plant that are disturbances of the synthesis too. By default all of them without
        a command, and none with it (the paper's choice).
    pose : sequence or mapping, optional
        Wanted values of the integrated states; the operating point is the equilibrium there. None: origin.
    equilibrium : (x*, u*), optional
        The operating point itself, where it is known: state (n,) and input (m,) of the plant. Instead of `pose`.

    Raises InvalidInput, NumericalFailure: if names do not fit, nothing disturbs, or the operating point is not an
    equilibrium.

    Examples
    --------
    >>> import flexhinf as fh
    >>> problem = fh.paper_arm().problem()
    >>> problem.state_names
    ('link_position', 'link_velocity', 'motor_position', 'motor_velocity', 'link_position_integral')
    """

    plant: Plant
    penalty: Penalty
    integrate: tuple[str, ...] = ()
    command: str | None = None
    disturbances: Sequence[str] | None = None
    pose: Mapping[str, float] | ArrayLike | None = None
    equilibrium: tuple[ArrayLike, ArrayLike] | None = None

    def __post_init__(self) -> None:
        checked_kind("A problem needs a plant.", self.plant, Plant, "a flexhinf.Plant", "robot.plant()")
        self.plant.check_continuous("problem of Eq. (3)")
        self.plant.check_driven("problem of Eq. (3)")
        checked_kind(
            "A problem needs a penalty.",
            self.penalty,
            Penalty,
            "a flexhinf.Penalty",
            "Penalty({'name': 1.0})",
        )
        checked_names("The integrated states", self.integrate)
        checked_names("The disturbances", () if self.disturbances is None else self.disturbances)
        refuse_if(
            self.command not in ("disturbance", None),
            "The command can enter the synthesis in one way only.",
            f"expected command='disturbance' or None, got {self.command!r}",
            "command='disturbance' for the paper's problem",
        )
        for name in self.integrate:
            self.plant.index(name)
        distinct("Of the integrated states", self.integrate)
        refuse_if(
            self.command and not self.integrate,
            "The command enters through the integral of the tracking error, and no state is integrated.",
            "expected integrate=(...) with command='disturbance', got integrate=()",
            "integrate=('link_position',)",
        )
        default = () if self.command else self.plant.disturbances
        channels = default if self.disturbances is None else self.disturbances
        channels = (channels,) if isinstance(channels, str) else tuple(channels)
        unknown = [name for name in channels if name not in self.plant.disturbances]
        refuse_if(
            unknown or not (channels or self.command) or len(set(channels)) != len(channels),
            f"There is no disturbance {unknown[0]!r}."
            if unknown
            else "The disturbances are none, or repeat.",
            f"expected distinct names out of {list(self.plant.disturbances)}, got {list(channels)}",
            "disturbances=(...), or command='disturbance'",
        )
        object.__setattr__(self, "disturbances", channels)
        self.penalty.r2(len(self.plant.inputs))
        self.plant.check_equilibrium(
            *self._equilibrium,
            "The operating point is not an equilibrium: f(x*) is not zero.",
            "pose=(...): the equilibrium at that pose is computed",
        )
        table = self.plant.parameters
        offset = np.asarray(
            self.penalty_output(np.zeros(len(self.state_names)), table.named(table.vector())), dtype=float
        )
        if offset.ndim != 1 or not np.all(np.abs(offset) <= EQUILIBRIUM_TOLERANCE):
            raise InvalidInput(
                "The penalty h(x) is not zero at the operating point.",
                f"expected a vector with h(0) = 0, got {offset.tolist()}",
                "a penalty on deviations from the operating point",
            )

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    # Names ----------------------------------------------------------------------------------------
    @property
    def state_names(self) -> tuple[str, ...]:
        """Plant states, then one integral per integrated state."""
        return (*self.plant.states, *(f"{name}_integral" for name in self.integrate))

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of u."""
        return tuple(self.plant.inputs)

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        """Names of d: commands first, then channels of the plant."""
        return (*(f"{name}_command" for name in self.integrate if self.command), *(self.disturbances or ()))

    # Operating point ------------------------------------------------------------------------------
    @cached_property
    def _equilibrium(self) -> tuple[np.ndarray, np.ndarray]:
        if self.equilibrium is not None:
            x, u = read_only(tuple(map(real_array, self.equilibrium)))
            shapes = (self.plant.n,), (len(self.plant.inputs),)
            refuse_if(
                self.pose is not None or (x.shape, u.shape) != shapes,
                "The operating point does not fit the plant.",
                f"expected equilibrium=(x*, u*) of shapes {shapes} and no pose, got {x.shape}, {u.shape}, "
                f"pose={self.pose!r}",
                "either pose or equilibrium",
            )
            object.__setattr__(self, "equilibrium", (x, u))
            return x, u
        if self.pose is None:
            return read_only((np.zeros(self.plant.n), np.zeros(len(self.plant.inputs))))
        return read_only(equilibrium_at(self.plant, self.integrate, pose_values(self.pose, self.integrate)))

    @property
    def operating_point(self) -> np.ndarray:
        """x*, plant states then integrals (zero), shape (n,)."""
        return np.concatenate([self._equilibrium[0], np.zeros(len(self.integrate))])

    @property
    def operating_input(self) -> np.ndarray:
        """u*, shape (m,)."""
        return self._equilibrium[1]

    def summary(self) -> dict[str, str]:
        """States, inputs, disturbances, R2 and operating point, for ``repr``."""
        point = self.plant.values_texts(self.plant.states, self._equilibrium[0])
        return {
            "states": names_text(self.state_names),
            "inputs": names_text(self.input_names),
            "disturbances": names_text(self.disturbance_names),
            "R2": ", ".join(self.plant.weights_texts(self.input_names, np.diag(self.r2))),
            "operating point": ", ".join(point[:6]) + (", …" if len(point) > 6 else "") or "origin",
        }

    # The problem ----------------------------------------------------------------------------------
    @property
    def r2(self) -> np.ndarray:
        """R2 of Eq. (4), (m, m), read-only."""
        return self._r2

    @cached_property
    def _r2(self) -> np.ndarray:
        return read_only(self.penalty.r2(len(self.plant.inputs)))

    def flow(self, x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
        """ẋ of the plant with its integrals, on any element; x, u are absolute, d as `disturbance_names`."""
        n, commands = self.plant.n, len(self.integrate) if self.command else 0
        channels = {name: d[commands + place] for place, name in enumerate(self.disturbances or ())}
        rates = self.plant.evaluate_flow(
            x[:n],
            u,
            np.array([channels.get(name, 0.0) for name in self.plant.disturbances]),
            self.plant.parameters.flat(p),
        )
        errors = [
            x[i] - self._equilibrium[0][i] - (d[place] if self.command else 0.0)
            for place, i in enumerate(map(self.plant.index, self.integrate))
        ]
        return np.array([*rates, *errors])

    def penalty_output(self, x: Elements, p: Parameters) -> Elements:
        """h(x) on any element; x is the deviation from the operating point, integrals included.

        A function h is evaluated like the plant's code: on numbers and symbols by its trace.
        """
        traced = self._penalty_code if callable(self.penalty.states) else None
        h = None if traced is None else traced.evaluate(x, self.plant.parameters.flat(p))
        return self.penalty.evaluate(x, self.state_names, p) if h is None else h

    @cached_property
    def _penalty_code(self) -> TracedCode:
        return TracedCode(self._trace_penalty())

    def _trace_penalty(self) -> ca.Function:
        names, table = self.state_names, self.plant.parameters

        def penalty(x: Elements, p: Elements) -> Elements:
            return signals("The penalty h(x, p)", lambda: self.penalty.evaluate(x, names, table.named(p)))

        return trace(penalty, len(names), table.size, name="penalty", names=("x", "p"))

    def check_unchanged(self) -> None:
        """Refuse a flow or a penalty that no longer computes what it did when it was built; see `Model`."""
        self.plant.check_unchanged()
        h = self.penalty.states
        traced = callable(h) and not isinstance(h, StoredCode)
        refuse_if(
            traced and digest(self._trace_penalty()) != digest(self._penalty_code.function),
            "The penalty h(x, p) computes something else than when its problem was built.",
            "expected the same operations and constants: a global or an attribute that it reads has changed",
            "build the problem anew: plant.with_objective(...)",
        )

    def expand(self, degree: int) -> PolynomialPlant:
        """Exact Taylor expansion about the operating point, at the nominal parameters.

        `degree` ≥ 1 is the highest of f and h; that of g1 and g2 is one less. The last expansion is kept: another γ for
        the same problem checks that its code is unchanged, and uses it again.
        """
        self.check_unchanged()
        expanded = self._expansion.get(degree)
        if expanded is None:
            expanded = expand_problem(self, degree)
            self._expansion.clear()
            self._expansion[degree] = expanded
        return expanded

    @cached_property
    def _expansion(self) -> dict[int, PolynomialPlant]:  # the last one, by its degree
        return {}

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "_expansion"}  # it may be large

    @cached_property
    def _traced_fields(self) -> ca.Function:
        """f, g1, g2, h as one CasADi function of the deviation x, at the nominal parameters."""
        n, m, k = len(self.state_names), len(self.input_names), len(self.disturbance_names)
        named, p = self.plant.parameters.named, self.plant.parameters.vector()

        def moved(x: Elements, u: Elements, d: Elements, p: Elements) -> Elements:
            return self.flow(x, u, d, named(p))

        flow = trace(moved, n, m, k, len(p), name="flow")
        x, u, d = symbols("x", n), ca.SX.sym("u", m), ca.SX.sym("d", k)
        rate = flow(pack(x + self.operating_point), u, d, ca.DM(p))
        nominal = [ca.DM(self.operating_input), ca.DM.zeros(k)]
        f, g1, g2 = (
            ca.substitute(v, ca.vertcat(u, d), ca.vertcat(*nominal))
            for v in (rate, ca.jacobian(rate, d), ca.jacobian(rate, u))
        )
        h = pack(self.penalty_output(x, named(p)))
        outputs = [f, ca.vec(ca.densify(g1).T), ca.vec(ca.densify(g2).T), h]  # C order
        return ca.Function("fields", [pack(x)], [ca.densify(o) for o in outputs], {"cse": True})

    @cached_property
    def _field_codes(self) -> tuple[ca.Function, tuple[np.ndarray | None, ...]]:
        """The traced fields that depend on x as one function, and the values of the constant ones (None elsewhere).

        Constant matrices of many points are most of what would otherwise be copied out of CasADi.
        """
        x = ca.SX.sym("x", len(self.state_names))
        outputs, values = self._traced_fields.call([x]), self._traced_fields.call([np.zeros(x.numel())])
        depends = [any(ca.which_depends(output, x, 1, True)) for output in outputs]
        varying = [output for varies, output in zip(depends, outputs) if varies]
        kept = tuple(None if varies else np.asarray(v, float).ravel() for varies, v in zip(depends, values))
        return ca.Function("varying_fields", [x], varying, {"cse": True}), kept

    @property
    def input_matrix_is_constant(self) -> bool:
        """Whether g2 does not depend on the state, as the code is written."""
        return self._field_codes[1][2] is not None

    def input_matrix(self, x: Elements) -> Elements:
        """Exact g2 (n, m) at one deviation x (n,), on numbers or symbols."""
        return apply(self._traced_fields, x)[2].reshape(len(self.state_names), -1)

    def fields(self, x: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Exact f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) at deviations x (N, n)."""
        points = np.atleast_2d(np.asarray(x, dtype=float))
        if points.ndim != 2 or points.shape[1] != len(self.state_names):
            raise InvalidInput(
                "The points do not fit the problem.",
                f"expected one column for each of {list(self.state_names)}, got shape {np.shape(x)}",
                "deviations from the operating point, integrals of the error included",
            )
        count, n = points.shape
        if not count:  # to CasADi, a matrix without columns is a zero
            f, g1, g2, h = self.fields(np.zeros((1, n)))
            return f[:0], g1[:0], g2[:0], h[:0]
        traced, constant = self._field_codes
        varying = iter(traced.call([points.T]))
        f, g1, g2, h = (
            np.broadcast_to(value, (count, len(value))) if value is not None else next(varying).full().T
            for value in constant
        )
        return f, g1.reshape(count, n, -1), g2.reshape(count, n, -1), h


# Equilibria ---------------------------------------------------------------------------------------
ITERATIONS = 50


def pose_values(
    pose: Mapping[str, float] | ArrayLike, names: Sequence[str], owner: str = "plant"
) -> np.ndarray:
    """One finite value per name, from a mapping (zero for names left out) or a sequence."""
    if isinstance(pose, Mapping):
        for name in [name for name in pose if name not in names]:
            raise unknown_name(f"The pose names {name!r}.", name, names)
        pose = [pose.get(name, 0.0) for name in names]
    what, advice = f"The pose does not fit the {owner}.", "one value per name, rad (m where it slides)"
    return checked_array(what, pose, (len(names),), f"{len(names)} finite values for {list(names)}", advice)


def equilibrium_at(
    plant: Plant, names: Sequence[str], values: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """State x* (n,) and input u* (m,) at rest, flow(x*, u*, 0) = 0 or x* of a map, with the named states at `values`,
    by Newton's method.

    Of several such points one near the origin, or near a `start` (n,), of which constant states stay. NumericalFailure,
    with the state that keeps moving, where there is none.
    """
    n = plant.n
    fixed = [plant.index(name) for name in names]
    x, u = np.zeros(n) if start is None else np.array(start), np.zeros(len(plant.inputs))
    constant = (
        [] if start is None else np.flatnonzero(~np.hstack(plant.change_slopes(x, u)).any(axis=1)).tolist()
    )
    free = [i for i in range(n) if i not in (*fixed, *constant)]
    x[fixed] = values
    rate, scale = plant.change(x, u), 1.0
    for _ in range(ITERATIONS):
        a, b, _ = plant.change_slopes(x, u)
        if not (np.all(np.isfinite(rate)) and np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
            break
        scale = max(1.0, float(np.abs(a).max() * np.abs(x).max()))
        step = np.linalg.lstsq(np.hstack([a[:, free], b]), -rate, rcond=None)[0]
        x[free] += step[: len(free)]
        u += step[len(free) :]
        rate = plant.change(x, u)
        if np.abs(step).max(initial=0.0) <= 1e-14 * max(1.0, np.abs(x).max(), np.abs(u).max()):
            break
    worst = int(np.argmax(np.abs(rate)))
    if not np.all(np.isfinite(rate)) or abs(rate[worst]) > 1e-9 * scale:
        raise NumericalFailure(
            "The plant has no equilibrium at this pose.",
            f"expected {plant.equilibrium_text}, got {plant.change_text(worst)} = {rate[worst]:.3g} at the best point",
            "a pose that the inputs can hold",
        )
    return x, u


def motion_of(signals: Any, times: np.ndarray, order: int, names: Sequence[str] = ()) -> np.ndarray:
    """Positions and their derivatives, (order + 1, N, n), at times (N,), s.

    Each signal has a method ``derivatives(t, order)`` (`flexhinf.loop.Signal`), or is a number, which is constant; they
    come in the order of the joints, or by `names`. One signal may have one column per joint.
    """
    if isinstance(signals, Mapping):
        named = cast(Mapping[str, Any], signals)
        refuse_if(
            not names or set(named) != set(names),
            "The signals by name are not those of the joints.",
            f"expected one for each of {list(names)}, got {list(named)}",
            "names=(...) in the order of the joints" if not names else "one signal, or number, for each",
        )
        signals = [named[name] for name in names]
    several = isinstance(signals, (Sequence, np.ndarray)) and not isinstance(signals, str)
    columns = [np.zeros((order + 1, len(times), 0))]
    parts: list[Any] = list(cast(Sequence[Any], signals)) if several else [signals]
    for signal in parts:
        if hasattr(signal, "derivatives"):
            columns.append(
                np.asarray(signal.derivatives(times, order), dtype=float).reshape(order + 1, len(times), -1)
            )
            continue
        columns.append(np.zeros((order + 1, len(times), 1)))
        try:
            columns[-1][0] = float(signal)
        except (TypeError, ValueError) as error:
            raise InvalidInput(
                "A signal of a moving reference has no derivatives.",
                f"expected a signal with derivatives(t, order), or a number, got {value_text(signal)}",
                "fh.Sine, fh.JerkLimited(..., smoothing=...), fh.Quintic; fh.Spline(times, values) for samples",
            ) from error
    motion = np.concatenate(columns, axis=2)
    count = motion.shape[2]
    refuse_if(
        count == 0 or (names and count != len(names)),
        "The number of signals is not that of the joints.",
        f"expected one for each of {list(names) or 'the joints'}, got {count}",
        "one signal per joint",
    )
    return motion


# Linear plants ------------------------------------------------------------------------------------
# On a linearisation the extended Kalman filter is the linear Kalman filter, and a loop is one that textbooks cover.
def linear_flow(x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
    """ẋ = A (x − x*) + B (u − u*) + G d, (n,) of any element."""
    rates = p.state_matrix @ (x - p.state) + p.input_matrix @ (u - p.input)
    return rates + p.disturbance_matrix @ d if np.size(p.disturbance_matrix) else rates


def linear_output(x: Elements, u: Elements, p: Parameters) -> Elements:
    """y = y* + C (x − x*) + D (u − u*), (p,) of any element."""
    return p.output + p.output_matrix @ (x - p.state) + p.feedthrough @ (u - p.input)


def linear_plant(plant: Plant, x: ArrayLike, u: ArrayLike) -> Plant:
    """The linearisation of a plant at an equilibrium (x, u), in absolute coordinates and with the plant's own names.

    Its parameters are the matrices and the equilibrium, so that two linearisations of the same size share code.
    """
    a, b, g, c = plant.linearise(x, u)
    x, u = real_array(x), real_array(u)
    plant.check_equilibrium(
        x,
        u,
        "A plant is linearised at an equilibrium.",
        "robot.operating_point(pose), or operating_point and operating_input of a problem",
    )
    names = "disturbances", "outputs", "units", "groups", "angles", "coupling"
    output, slope = plant.output_at(x, u)
    return _linear_plant(
        (a, b, g, c, slope, x, u, output),
        plant.states,
        plant.inputs,
        **{name: getattr(plant, name) for name in names},
    )


def _linear_plant(
    values: tuple[np.ndarray, ...], states: Sequence[str], inputs: Sequence[str], **names: Any
) -> Plant:
    kinds = "state_matrix input_matrix disturbance_matrix output_matrix feedthrough state input output"
    parameters = dict(zip(kinds.split(), values))
    return Plant(linear_flow, linear_output, states, inputs, parameters=parameters, **names)


def plant_from_control(system: Any, inputs: Sequence[str] | None = None) -> Plant:
    """A linear system in continuous time of python-control (``ss`` or ``tf``) as a plant.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
    inputs : sequence of str, optional
        Names of the system's inputs that a controller sets; the others are disturbances. All by default.

    Raises InvalidInput: if it is no linear system in continuous time, or has no such inputs.
    """
    package = python_control()
    refuse_if(
        not isinstance(system, package.StateSpace | package.TransferFunction) or system.isdtime(strict=True),
        "The system cannot become a plant.",
        "expected a linear system in continuous time, got "
        f"{type(system).__name__} with dt={getattr(system, 'dt', None)}",
        "control.ss(A, B, C, D); a nonlinear plant is a function, see flexhinf.Plant",
    )
    linear = package.ss(system)
    labels = list(linear.input_labels)
    chosen = labels if inputs is None else list(inputs)
    refuse_if(
        not set(chosen) <= set(labels) or not chosen,
        "The system has no such inputs.",
        f"expected some of {labels}, got {chosen}",
        str(labels[:1]),
    )
    places = [labels.index(name) for name in chosen]
    others = [k for k, name in enumerate(labels) if name not in chosen]
    a, b, c, d = (np.asarray(m, dtype=float) for m in (linear.A, linear.B, linear.C, linear.D))
    disturbances = tuple(labels[k] for k in others)
    refuse_if(
        d[:, others].any(),
        "A disturbance acts on a measurement directly.",
        f"expected D = 0 for {list(disturbances)}",
        "measurement noise is the loop's; other disturbances act through a state",
    )
    still = map(np.zeros, (len(a), len(chosen), len(c)))
    values = a, b[:, places], b[:, others], c, d[:, places], *still
    names = {"disturbances": disturbances, "outputs": tuple(linear.output_labels)}
    return _linear_plant(values, tuple(linear.state_labels), tuple(chosen), **names)
