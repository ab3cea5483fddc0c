"""A robot: parameters with tolerances, and the plants and problems made of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Elements, Number, Numbers
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import Pictured, names_text
from flexhinf.plant import GeneralisedPlant, Parameters, ParameterTable, Penalty, Plant, StateWeights
from flexhinf.plant.instruments import SENSORS
from flexhinf.plant.parameters import ParameterValues
from flexhinf.robot.arm import Arm, Links, Pendulum
from flexhinf.robot.drives import DRIVES, VOLTAGE, DriveKind
from flexhinf.robot.elastic import (
    DRY,
    EXTRAS,
    ORDERS,
    SPRING,
    ElasticFlow,
    InverseFlow,
    Sticking,
    checked_extras,
    reflected,
    required_of_drive,
    traced_inverse,
)
from flexhinf.robot.equilibrium import equilibrium, plant_columns
from flexhinf.robot.joint_sensors import JointSensor, check_sensors
from flexhinf.robot.layout import Layout, checked_coupling
from flexhinf.robot.modes import Mode, modes_of, stiffness_and_inertia
from flexhinf.robot.parameters import (
    Parameter,
    PlantValues,
    check_parameters,
    checked_brakes,
    checked_limits,
    corner_groups,
    estimated_quantities,
    per_joint,
    random_signs,
    unit_of,
)
from flexhinf.robot.poses import checked_home, checked_pose
from flexhinf.robot.saved_file import save_robot
from flexhinf.robot.signals import (
    MECHANICAL,
    UNITS,
    Sensors,
    expanded,
    robot_penalty,
    signal_names,
    units_of,
)
from flexhinf.robot.springs import DAMPING, springs_of
from flexhinf.scalars import derivative, series
from flexhinf.validation import (
    checked_kind,
    checked_name,
    checked_names,
    checked_text,
    one_of,
    real_array,
    real_number,
)


@dataclass(frozen=True, repr=False)
class Robot(Pictured):
    """A robot with elastic joints.

    Parameters
    ----------
    parameters : sequence of Parameter
        Physical numbers with tolerances and sources, one per joint where there are several joints.
    penalty : Penalty, optional
        The robot's own penalty, used by `problem`.
    links : Links
        A single link in closed form, or an `Arm`.
    drive : str
        What the inputs are, on the link side: the name of a kind in `flexhinf.robot.drives`, which has their unit.
    drive_delay, drive_period : float
        Longest time from a command to a drive's loop, and between two commands that it takes, s.
    home : (n,), optional
        Link positions that are meant when no pose is given, rad or m; zero by default.
    effort_limits : (m,), optional
        Largest absolute input of each motor, in the unit of `drive`; None or infinite for a motor without a limit.
    speed_limits : (n,), optional
        Largest absolute velocity of each link, rad/s or m/s; as above. (Ranges of the positions belong to `links`.)
    command_rates, command_accelerations : (m,), optional
        Largest absolute rate and acceleration of each input, in the unit of `drive` per s and per s²; as above.
    rigid : sequence of str, optional
        Names of joints without a spring, whose rotor turns with the link. One joint at least is elastic.
    coupling : (n, n), optional
        T of θ = T q, where motors move more than their own joints; see `flexhinf.robot.layout`.
    brakes : (n,) bool, optional
        Whether a joint has a brake that closes without power; by default none has. It says how a protective stop ends.
    sensors : sequence of JointSensor, optional
        The sensors that the robot has, with their steps and noise. Without any, a design may measure whatever it names.
    file, reader : Path and function, optional
        The robot file that it was read from, and how: the robot of a path, read in the same way.

    Raises InvalidInput: for parameters of another model, a home pose outside the limits, a limit that is not positive.

    Examples
    --------
    >>> import flexhinf as fh
    >>> arm = fh.load_robot("planar-two-link")
    >>> arm.joint_names
    ('shoulder', 'elbow')
    >>> state, torque = arm.operating_point((0.3, 0.5))
    """

    name: str
    parameters: tuple[Parameter, ...]
    penalty: Penalty | None = None
    links: Links = field(default_factory=Pendulum)
    drive: str = VOLTAGE.name
    home: Sequence[float] | None = None
    description: str = ""
    effort_limits: Sequence[float | None] | None = None
    speed_limits: Sequence[float | None] | None = None
    rigid: Sequence[str] = ()
    coupling: Sequence[Sequence[float]] = ()
    brakes: Sequence[bool] = ()
    sensors: Sequence[JointSensor] = ()
    drive_delay: float = 0.0
    drive_period: float = 0.0
    command_rates: Sequence[float | None] | None = None
    command_accelerations: Sequence[float | None] | None = None
    file: Path | None = field(default=None, compare=False)
    reader: Callable[[Path], Robot] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        checked_name("a robot", self.name, spaces=True)
        checked_text(f"the description of the robot {self.name!r}", self.description)
        what, some = f"The parameters of the robot {self.name!r} are not usable.", self.parameters
        checked_kind(what, some, (list, tuple), "Parameters in a tuple", "robot.parameters of another robot")
        for parameter in some:
            checked_kind(what, parameter, Parameter, "a Parameter each", "flexhinf.Parameter('mass', 0.2)")
        none = f"The links of the robot {self.name!r} are none."
        checked_kind(none, self.links, (Pendulum, Arm), "a Pendulum or an Arm", "links of another robot")
        checked_kind(f"The drive of {self.name!r} is no name.", self.drive, str, "text", repr(VOLTAGE.name))
        checked_names("The rigid joints", self.rigid)
        object.__setattr__(self, "parameters", tuple(some))
        refuse_if(
            not set(self.rigid) < set(self.joint_names),
            f"No joint of the robot {self.name!r} is elastic, or a rigid one is not among them.",
            f"expected some of {list(self.joint_names)}, got {list(self.rigid)}",
            "the stiffness of one joint at least: a stiff spring is nearly rigid",
        )
        object.__setattr__(self, "rigid", tuple(name for name in self.joint_names if name in self.rigid))
        object.__setattr__(self, "sensors", tuple(self.sensors))
        object.__setattr__(
            self, "coupling", checked_coupling(self.name, self.coupling, self.joint_names, self.rigid)
        )
        check_sensors(self.name, self.sensors, self.joint_names, self.rigid)
        object.__setattr__(self, "brakes", checked_brakes(self.name, self.brakes, self.joint_names))
        names = [parameter.name for parameter in self.parameters]
        needed = (*self.links.required(), *required_of_drive(self.drive, names, self.joint_names, self.rigid))
        missing = [name for name in needed if name not in names]
        refuse_if(
            missing or len(set(names)) != len(names),
            f"The robot {self.name!r} does not have the parameters of its model.",
            f"expected each of {list(needed)} once, got {names}",
            f"add {missing}" if missing else "each name once",
        )
        check_parameters(self.name, self.parameters, dict(zip(self.joint_names, self.links.slides)))
        home = checked_home(self.home, self.links, self.name)
        object.__setattr__(self, "home", tuple(home.tolist()))
        for kind in ("effort_limits", "speed_limits", "command_rates", "command_accelerations"):
            what = f"The {kind.replace('_', ' ')} of the robot {self.name!r}"
            limits = checked_limits(what, getattr(self, kind), self.joint_names)
            object.__setattr__(self, kind, tuple(limits.tolist()))

    # Numbers --------------------------------------------------------------------------------------
    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of all signals."""
        return self.links.tree.names

    @cached_property
    def layout(self) -> Layout:
        """Where the joints stand in the state of `plant`."""
        return Layout.named(self.joint_names, self.rigid, self.coupling)

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Nominal values by name."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    def summary(self) -> dict[str, str]:
        """Name, joints, drive, parameters and how many of them have a tolerance, for ``repr``."""
        return {
            "name": self.name,
            "joints": names_text(self.joint_names),
            "drive": self.drive,
            "parameters": f"{len(self.parameters)}, {len(self.uncertain)} with a tolerance",
            "penalty of its own": "no" if self.penalty is None else "yes",
        }

    @cached_property
    def estimated(self) -> dict[str, tuple[str, ...]]:
        """Joints whose numbers are estimates and were not measured, by quantity; no joint for gravity."""
        return estimated_quantities(self.parameters, self.joint_names)

    def __getitem__(self, name: str) -> Parameter:
        one_of(f"The robot {self.name!r} has no parameter {name!r}.", name, tuple(self.nominal))
        return next(parameter for parameter in self.parameters if parameter.name == name)

    def with_values(self, values: Mapping[str, float]) -> Robot:
        """The same robot with other nominal values; unknown names and what is no mapping raise InvalidInput."""
        checked_kind("The values are not named.", values, Mapping, "a mapping", "{'stiffness': 1.61}")
        return self.with_parameters(
            *(replace(self[name], value=real_number(values[name])) for name in values)
        )

    def with_parameters(self, *parameters: Parameter) -> Robot:
        """The same robot with these parameters, in place of those of the same name or beside them."""
        return replace(self, parameters=tuple({p.name: p for p in (*self.parameters, *parameters)}.values()))

    @cached_property
    def assumed_damping(self) -> dict[str, Parameter]:
        """Damping D = τ K by elastic joint of which the robot states none, N·m·s/rad or N·s/m; 0 counts as stated. τ is
        that of `flexhinf.robot.springs` at home."""
        joints, plant, found = self.joint_names, self.plant(), dict[str, Parameter]()
        for spring in springs_of(plant.linearise(*self.operating_point())[0], plant, joints, self.layout):
            name, stiffness = (per_joint(each, spring.joint, len(joints)) for each in (DAMPING, "stiffness"))
            if name not in self.nominal:
                unit = unit_of(DAMPING, self.links.slides[joints.index(spring.joint)])
                found[spring.joint] = Parameter(name, spring.time * self.nominal[stiffness], unit=unit)
        return found

    @property
    def drive_kind(self) -> DriveKind:
        """The kind of drive that is called `drive`."""
        return DRIVES[self.drive]

    @cached_property
    def damped(self) -> Robot:
        """The same robot with `assumed_damping`; the robot itself where its springs state theirs."""
        return self.with_parameters(*self.assumed_damping.values()) if self.assumed_damping else self

    def with_rigid(self, *joints: str) -> Robot:
        """The same robot with these joints rigid too: the numbers of their springs are left out."""
        lost = (*SPRING, "load_friction")  # no spring says what the load is
        springs = {per_joint(name, joint, len(self.joint_names)) for name in lost for joint in joints}
        kept = tuple(parameter for parameter in self.parameters if parameter.name not in springs)
        twists = [name for name, kind in SENSORS.items() if kind.of_springs]
        gone = {per_joint(name, joint, len(self.joint_names)) for name in twists for joint in joints}
        sensors = tuple(sensor for sensor in self.sensors if sensor.signal not in gone)
        return replace(self, parameters=kept, rigid=(*self.rigid, *joints), sensors=sensors)

    def save(self, path: str | os.PathLike[str], like: str | os.PathLike[str] | None = None) -> None:
        """Write a robot file: `file` (or the file `like`) with this robot's numbers, tolerances and ranges.

        Comments and everything else stay: of `like`, numbers that differ from this robot's are written, and no others.
        Raises InvalidInput: if the robot comes from no robot file, `like` is of another robot, or a number that is
        changed stands in a vector there.
        """
        save_robot(self, path, like)

    def plant_parameters(self, values: Mapping[str, float] | None = None) -> PlantValues:
        """The parameters of the robot's plants: reflected to the link side, arrays where there are joints.

        `values` are all parameters of the robot by name, nominal by default.
        """
        values = self.nominal if values is None else values
        arrays = {
            name: column[0] if isinstance(self.links, Pendulum) else np.array(column)
            for name, column in reflected(values, self.drive, self.joint_names, self.rigid).items()
        }
        return PlantValues(self.links.packed(values) | arrays, values)

    @cached_property
    def _table(self) -> ParameterTable:
        """The nominal parameters of the robot's plants."""
        return ParameterTable(self.plant_parameters())

    # Plants ---------------------------------------------------------------------------------------
    def plant(
        self, measured: str | Sequence[str] = ("link_position",), inductance: bool = False,
        extras: str | Sequence[str] = (), sticking: bool = False,
    ) -> Plant:  # fmt: skip
        """The physical plant: Spong's model, with the extras of a real joint that are requested.

        The states are all link positions, all link velocities, all motor positions, all motor velocities, and
        with `inductance` all coil currents. With one joint they have these plain names; with several each has
        the joint's name behind it (``link_position_elbow``), and the plain name stands for all of them. Motor
        signals are seen from the link side.

        Parameters
        ----------
        measured : sequence of str
            Measured signals, by the names of kinds in `flexhinf.plant.instruments` (link_position, motor_position and
            others), of all joints or of single ones (``motor_position_elbow``), in any mix.
        inductance : bool
            With the motor coils' inductance: the same as ``extras=("inductance",)``.
        extras : sequence of str
            See `flexhinf.robot.elastic`: inductance, joint_damping, spring_hardening, stiffness_curve,
            kinematic_error, torque_ripple, backlash, coulomb_friction, stribeck_friction, load_friction.
        sticking : bool
            Whether dry friction is sharp instead of smoothed: it holds a joint at rest, and only `flexhinf.Loop` has
            it; flow and linearisation have none. A robot with rigid joints has it smoothed in any case.

        Raises InvalidInput: for unknown names, numbers of the wrong sign, or an extra whose number the robot
        does not state.
        """
        on = checked_extras(extras, inductance, self.plant_parameters(), self.name)
        sensors = expanded(measured, SENSORS, self.joint_names, self.rigid)
        sticks = tuple(name for name in on if name in DRY) if sticking and not self.rigid else ()
        on = tuple(name for name in on if name not in sticks)
        key = sensors, on, sticks
        # Each is traced once, and none can be changed.
        built: dict[tuple[tuple[str, ...], ...], Plant] = vars(self).setdefault("_plants", {})
        if key in built:
            return built[key]
        joints = self.joint_names
        quantities = (*MECHANICAL, "coil_current") if "inductance" in on else MECHANICAL
        built[key] = Plant(
            ElasticFlow(self.links, self.drive, on, self.layout),
            Sensors(sensors, joints, on, self.layout),
            states=[name for quantity in quantities for name in signal_names(quantity, joints, self.rigid)],
            inputs=signal_names(self.drive_kind.quantity, joints),
            disturbances=(*signal_names("link_torque", joints), *signal_names("motor_torque", joints)),
            parameters=self.plant_parameters(),
            outputs=sensors,
            units=units_of(joints, self.links.slides, self.plant_parameters()),
            groups={name: signal_names(name, joints, self.rigid) for name in UNITS if len(joints) > 1},
            limits={
                name: ends
                for name, ends in zip(signal_names("link_position", joints), self.links.limits)
                if ends is not None
            },
            engaged=self.layout.engaged if "backlash" in on else None,
            coupling=self.layout.coupling,
            arrest=Sticking(self.layout, sticks, on, self.drive) if sticks else None,
        )
        return built[key]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_plants"}  # built again

    def operating_point(
        self,
        pose: Numbers = None,
        extras: str | Sequence[str] = (),
        parameters: ParameterValues | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The equilibrium (x, u) of `plant` at a pose: q2 = q1 + K⁻¹ G(q1), exactly, and the input that holds it.

        Parameters
        ----------
        pose : sequence, mapping by joint name, or number for one joint
            Link positions within the joints' limits, rad or m; the robot's home by default.
        extras : sequence of str
            As for `plant`: they change the spring, and add the coil's state.
        parameters : mapping, optional
            Those of the plant, as `corner` and `draw` return them; nominal by default.
        """
        q = checked_pose(pose, np.asarray(self.home), self.links, self.name)
        packed = {**self.plant_parameters(), **(parameters or {})}
        on = checked_extras(extras, False, packed, self.name)
        return equilibrium(self.links, self.drive, self.layout, q, packed, on)

    def starting_states(
        self, poses: np.ndarray, extras: str | Sequence[str], parameters: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """The states (N, n) of `operating_point` at poses (N, j) of N robots, each with the bits that it has alone.

        `parameters` (N, …) are all of the plant's, as `varied` returns them.
        """
        for end in (np.min, np.max):
            checked_pose(end(poses, axis=0), np.asarray(self.home), self.links, self.name)
        columns = {name: np.moveaxis(column, 0, -1) for name, column in parameters.items()}
        if isinstance(self.links, Pendulum):
            columns = {name: np.atleast_2d(column) for name, column in columns.items()}
        on = checked_extras(extras, False, columns, self.name)
        return equilibrium(
            self.links, self.drive, self.layout, np.asarray(poses, dtype=float).T, columns, on
        )[0].T

    def modes(self, pose: Numbers = None, parameters: ParameterValues | None = None) -> tuple[Mode, ...]:
        """Modes of the uncontrolled robot near the equilibrium at a pose, slowest first: how its springs vibrate.

        They are eigenvalues of the linearised `plant`, one for each conjugate pair, with ``frequency`` (|λ|/2π, Hz),
        ``damping`` (−Re λ/|λ|), ``eigenvalue`` (1/s), ``name`` (vibration, swing, motion, fall, free motion) and
        ``joint``, where most of the motion is. Pose and parameters are as for `operating_point`.

        Examples
        --------
        >>> import flexhinf as fh
        >>> arm = fh.load_robot("planar-two-link")
        >>> [mode for mode in arm.modes((0.8, 1.0)) if mode.name == "vibration"]
        [<vibration of shoulder: 3.188 Hz, damping 0.359>, <vibration of elbow: 9.859 Hz, damping 0.101>]
        """
        plant = self.plant().with_parameters(**parameters) if parameters else self.plant()
        equilibrium = self.operating_point(pose, parameters=parameters)
        energy = stiffness_and_inertia(plant, equilibrium)
        return modes_of(plant.linearise(*equilibrium)[0], self.joint_names, *energy)

    def inverse_dynamics(
        self, q: Numbers, dq: Numbers = None, ddq: Numbers = None, dddq: Numbers = None, ddddq: Numbers = None,
        extras: str | Sequence[str] = (), parameters: ParameterValues | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """State and input of a motion of the links: elastic inverse dynamics [deluca2016], exact.

        Link positions q (rad, m) and four time derivatives, (n,) or (N, n) each and zero by default, give the state,
        (4n,) or (N, 4n), and the input, (n,) or (N, n), V, A, or N·m (N), of `plant`. Of the `extras` dry
        friction and the stiffness curve are modelled; others are refused by name. `parameters` are those of
        `operating_point`.
        """
        table = ParameterTable({**self._table.values, **parameters}) if parameters else self._table
        flow = InverseFlow(
            self.links, self.drive, checked_extras(extras, False, table.values, self.name), self.layout
        )
        joints, arrays = self.joint_names, list[np.ndarray]()
        for name, value in zip(ORDERS, (q, dq, ddq, dddq, ddddq)):
            array = np.zeros(len(joints)) if value is None else np.atleast_1d(real_array(value))
            if array.ndim not in (1, 2) or array.shape[-1] != len(joints) or not np.all(np.isfinite(array)):
                got = repr(value) if array.size <= 8 else f"shape {array.shape}, or not finite"
                raise InvalidInput(
                    f"The motion's {name} does not fit the robot.",
                    f"expected finite numbers, ({len(joints)},) or (N, {len(joints)}) for {list(joints)}, got {got}",
                    "one column per joint, one row per time",
                )
            arrays.append(array)
        counts = {len(array) for array in arrays if array.ndim == 2} or {1}
        refuse_if(
            len(counts) > 1,
            "The motion's derivatives have different numbers of times.",
            f"expected one, got {[array.shape for array in arrays]}",
            "a row per time",
        )
        count = counts.pop()
        if not count:
            return np.zeros((0, self.layout.mechanical)), np.zeros((0, len(joints)))
        columns = [np.broadcast_to(array, (count, len(joints))).T for array in arrays]
        inverse = traced_inverse(flow, tuple((name, value.shape) for name, value in table.values.items()))
        x, u = (np.array(rows, dtype=float).T for rows in inverse(*columns, table.vector()))
        return (x[0], u[0]) if all(array.ndim == 1 for array in arrays) else (x, u)

    def inverse_flow(
        self, q: Elements, dq: Elements, ddq: Elements, dddq: Elements, ddddq: Elements, p: Parameters
    ) -> tuple[Elements, Elements]:
        """`inverse_dynamics` at one point for laws: on any element, the plant's parameters p as attributes."""
        return InverseFlow(self.links, self.drive, layout=self.layout)(q, dq, ddq, dddq, ddddq, p)

    def flat_coordinates(self, x: Elements, p: Parameters) -> tuple[Elements, Elements, Elements, Elements]:
        """(q, q̇, q̈, q⃛), (n,) each, of an undisturbed state x of `plant`, on any element: back from `inverse_flow`.

        They are the coordinates in which the robot is n chains of four integrators. The state of a robot with rigid
        joints, whose accelerations depend on the input, does not give them.
        """
        refuse_if(
            self.rigid,
            "A robot with rigid joints has no flat coordinates: its state alone does not give q̈ and q⃛.",
            f"expected elastic joints only, got the rigid {list(self.rigid)}",
            "a law without exact linearisation",
        )
        q, dq, theta, dtheta = self.layout.split(x)
        pairs = (q, theta), (dq, dtheta)
        spring, rate = (self.layout.on_links(p.stiffness * (b - self.layout.at_springs(a))) for a, b in pairs)
        ddq = self.links.accelerations(q, dq, spring, p)
        moved = self.links.accelerations(series(q, dq), series(dq, ddq), series(spring, rate), p)
        return q, dq, ddq, derivative(moved, 1)

    def problem(
        self,
        penalty: Penalty | StateWeights | None = None,
        pose: Numbers = None,
        measured: str | Sequence[str] = ("link_position",),
        command: str | None = "disturbance",
        disturbances: str | Sequence[str] | None = None,
        integrate: str | Sequence[str] = ("link_position",),
        extras: str | Sequence[str] = (),
    ) -> GeneralisedPlant:
        """The synthesis problem about the equilibrium at a pose; by default the paper's.

        That is: the robot's own penalty, five states per joint, the command as the disturbance.

        Parameters
        ----------
        penalty : Penalty or weights, optional
            Instead of the robot's own; weights alone, without an effort, keep the robot's own R2 (1 where it states
            no penalty), see `Penalty`. Weights by name are those of states, of ``link_position_integral``, of
            ``joint_torque`` (deviation of the spring's torque) and of ``joint_torque_rate`` (its rate: the vibration);
            a plain name stands for all joints, with one weight for all or one each. The effort is the input's weight.
        pose : sequence or mapping, optional
            Link positions to design about, rad or m; the robot's home by default.
        measured : sequence of str
            As for `plant`.
        command : {"disturbance", None}
            Whether the commanded position is a disturbance of the synthesis (the paper's g1).
        disturbances : sequence of str, optional
            Torques that are disturbances: link_torque, motor_torque, of all joints or single ones.
        integrate : sequence of str
            Whose tracking error is integrated.
        extras : sequence of str
            As for `plant`; only those that are smooth.

        Raises InvalidInput: if there is no penalty, something does not fit, or the pose leaves the limits.
        """
        chosen = self.penalty if penalty is None else penalty
        if self.penalty is not None and not isinstance(chosen, Penalty):
            chosen = replace(self.penalty, states=chosen)
        if chosen is None:
            raise InvalidInput(
                f"The robot {self.name!r} states no penalty of its own.",
                "expected penalty=..., got none",
                "Penalty({'link_position': 60, 'link_position_integral': 300}, effort=10), or [penalty] in its file",
            )
        plant = self.plant(measured, extras=extras)
        states = (*plant.states, *(f"{name}_integral" for name in plant.expanded(integrate)))
        weights = robot_penalty(
            Penalty.of(chosen).expanded(plant.groups), self.joint_names, states, plant.groups, self.layout
        )
        return plant.with_objective(
            weights, command, integrate, None, disturbances, self.operating_point(pose, extras)
        )

    # Tolerances -----------------------------------------------------------------------------------
    @cached_property
    def uncertain(self) -> tuple[Parameter, ...]:
        """Parameters whose interval has a positive width (a tolerance in per cent of zero has none)."""
        return tuple(p for p in self.parameters if p.interval[0] < p.interval[1])

    def draw(self, rng: np.random.Generator) -> PlantValues:
        """Parameters of a plant (`Plant.with_parameters`), the uncertain ones uniform in their intervals."""
        return self.varied({p.name: rng.uniform(*p.interval) for p in self.uncertain})

    @cached_property
    def dry_by_viscous(self) -> dict[str, str]:
        """Names of dry friction that states no tolerance, and of the viscous friction of the same joint, in proportion
        to which it varies."""
        joints = self.joint_names
        own = {p.name for p in self.parameters if p.tolerance or p.range is not None}
        kinds = [((EXTRAS[kind], "friction"), joint) for kind in DRY for joint in joints]
        pairs = [tuple(per_joint(name, joint, len(joints)) for name in names) for names, joint in kinds]
        return {dry: wet for dry, wet in pairs if dry in {*self.nominal} - own and self.nominal[wet] > 0.0}

    def varied(self, values: Mapping[str, Number]) -> PlantValues:
        """Parameters of a plant, those of `values` in place of the nominal ones, with `dry_by_viscous`; names that are
        not the robot's are left out. Values may be arrays (N,), of N robots; so are then all parameters, (N, …)."""
        own = {name: value for name, value in values.items() if name in self.nominal}
        wet = {name: by for name, by in self.dry_by_viscous.items() if by in own}
        dry = {name: self.nominal[name] * own[by] / self.nominal[by] for name, by in wet.items()}
        whole = {**self.nominal, **dry, **own}
        shape = np.broadcast_shapes(*(np.shape(value) for value in values.values()))
        if not shape:
            return self.plant_parameters(cast("dict[str, float]", whole))
        return plant_columns(self.links, self.drive, self.joint_names, self.rigid, whole, shape)

    def corner(self, signs: Mapping[str, float] | Sequence[float]) -> PlantValues:
        """Parameters of a plant (`Plant.with_parameters`), the uncertain ones at one end of their intervals.

        Signs come by name (0 if absent), or one for each uncertain parameter: −1, 0 or 1 for the lower end, nominal and
        the upper end, or anything between; InvalidInput for others.
        """
        if not isinstance(signs, Mapping):
            names = [parameter.name for parameter in self.uncertain]
            refuse_if(
                len(signs) != len(names),
                "A corner needs one sign per uncertain parameter.",
                f"expected one for each of {names}, got {len(signs)}",
                "−1, 0 or 1 for each",
            )
            signs = dict(zip(names, signs, strict=True))
        for name, sign in signs.items():
            if name not in self.nominal or not -1.0 <= sign <= 1.0:
                raise InvalidInput(
                    f"The sign for {self[name].name!r} leaves its tolerance.",  # refuses an unknown one
                    f"expected −1 to 1, got {sign!r}",
                    "−1, 0 or 1",
                )
        moved = {p.name: p.at(float(signs[p.name])) for p in self.uncertain if signs.get(p.name)}
        return self.varied(moved)

    @cached_property
    def heaviest(self) -> PlantValues:
        """Parameters as of `corner`, with masses and payloads at the upper ends of their tolerances."""
        heavy = [p.name for p in self.uncertain if p.name.startswith(("mass", "payload_mass"))]
        return self.corner(dict.fromkeys(heavy, 1.0))

    def random_corners(self, count: int, seed: int) -> list[PlantValues]:
        """Parameters as of `corner` at random corners of the tolerances (`corner_groups`); none without tolerances."""
        groups, alone = corner_groups(self.uncertain)
        signs = random_signs(len(groups), count if groups else 0, seed) @ alone
        return [self.corner(row) for row in signs.tolist()]
