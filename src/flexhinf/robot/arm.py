"""The links of an arm of n joints, with parameters that are arrays: perturbing them compiles nothing.

A single link in closed form, as in Sec. 6: its inertia is stated about the joint's axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import (
    Joint,
    Tree,
    bodies_of,
    forward_dynamics,
    inverse_dynamics,
    lumped,
    matrix_of,
    six_of,
)
from flexhinf.robot.parameters import INERTIA, VECTOR, per_joint
from flexhinf.validation import HUGE, real_array, value_text


class JointTree:
    """Joints of a robot's links: names, which of them slide, and ranges (rad, m)."""

    tree: Tree

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.tree.names

    @property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint is prismatic."""
        return tuple(joint.slides for joint in self.tree.joints)

    @property
    def limits(self) -> tuple[tuple[float, float] | None, ...]:
        """Range of each joint, rad or m."""
        return tuple(joint.limits for joint in self.tree.joints)


@dataclass(frozen=True)
class Pendulum(JointTree):
    """I q̈1 + m g l sin q1 = spring torque + disturbance; q1 = 0 hangs. Its tree is of one joint that turns.

    Parameters of the plant are plain numbers with the names of the paper's Tables 1 and 2.
    """

    tree: Tree = field(default_factory=lambda: Tree((Joint("joint"),)))
    down: ClassVar[tuple[float, float, float]] = (1.0, 0.0, 0.0)  # of free fall, in the frame of `rigid`

    def required(self) -> tuple[str, ...]:
        """Names of the parameters that the link must have."""
        return ("mass", "length", "gravity", "link_inertia")

    def packed(self, values: Any) -> dict[str, Any]:
        """The link's parameters as the plant has them, with its payload.

        Of a payload only what is in the plane of motion counts: its distance x from the axis along the link, and its
        moment zz.
        """
        own = {name: values[name] for name in self.required()}
        own["link_inertia"] *= values.get("inertia_scale", 1.0)
        if load := values.get("payload_mass", 0.0):
            arm, about = (
                values.get(f"payload_{name}", 0.0) for name in ("centre_of_mass_x", "inertia_per_mass_zz")
            )
            mass = own["mass"] + load
            own["length"] = (own["mass"] * own["length"] + load * arm) / mass
            own["link_inertia"] += load * (arm * arm + about)
            own["mass"] = mass
        return own

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any, armature: Any = None) -> Any:
        """q̈1 = (τ − m g l sin q1) / I."""
        assert armature is None  # a single joint is elastic
        inverse, weight = 1.0 / p.link_inertia, p.mass * p.gravity * p.length / p.link_inertia
        return inverse * torque - weight * np.sin(q)

    def torques(self, q: Any, dq: Any, ddq: Any, p: Any) -> Any:
        """I q̈1 + m g l sin q1, (1,) of any element."""
        return p.link_inertia * ddq + p.mass * p.gravity * p.length * np.sin(q)

    def gravity_torque(self, q: Any, p: Any) -> Any:
        """M g l sin q1, (1,), N·m, of any element."""
        return p.mass * p.gravity * p.length * np.sin(np.asarray(q))

    def fall(self, p: Any) -> tuple[Any, ...]:
        """Acceleration of free fall in the frame of `rigid`, m/s²."""
        return (p.gravity, 0.0, 0.0)

    def rigid(self, p: Any) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        """A rigid link that moves alike, about z with x pointing down: tree, mass, centre of mass, inertia.

        Only m l and I count. Half the lever with twice the mass keeps both, and leaves an inertia about the centre
        of mass, I − m l²/2, that is positive even for a point mass.
        """
        mass, length = float(p.mass), float(p.length)
        about = float(p.link_inertia) - 0.5 * mass * length**2
        six = [[about, 0.0, 0.0, about, 0.0, about]]
        return self.tree, np.array([2.0 * mass or 1.0]), np.array([[0.5 * length, 0.0, 0.0]]), np.array(six)


@dataclass(frozen=True)
class Arm(JointTree):
    """A tree of rigid links.

    Parameters of the plant: ``gravity``, ``mass`` (n,), ``centre_of_mass`` (n, 3) in each link's frame, and
    ``inertia`` (n, 6), xx xy xz yy yz zz about the centre of mass in axes parallel to the link's frame.

    The tree is constant; `down` is the direction of free fall in the world's frame, made a unit vector.
    """

    tree: Tree
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def __post_init__(self) -> None:
        vector = real_array(self.down)
        length = float(np.linalg.norm(vector))
        if vector.shape != (3,) or not 1.0 / HUGE < length < HUGE:
            raise InvalidInput(
                "The direction of gravity is none.",
                f"expected three numbers, got {value_text(self.down)}",
                "[0, 0, -1]",
            )
        object.__setattr__(self, "down", tuple(float(entry) / length for entry in vector))

    def _names(self, joint: str, quantity: str, components: tuple[str, ...]) -> list[str]:
        return [per_joint(f"{quantity}_{component}", joint, len(self.tree)) for component in components]

    def required(self) -> tuple[str, ...]:
        """Names of the parameters that the links must have."""
        names = ["gravity"]
        for joint in self.tree.names:
            names.append(per_joint("mass", joint, len(self.tree)))
            names += self._names(joint, "centre_of_mass", VECTOR) + self._names(joint, "inertia", INERTIA)
        return tuple(names)

    def packed(self, values: Mapping[str, float]) -> dict[str, Any]:
        """The links' parameters as the plant has them: each link with its payload."""
        rows, count = self.tree.names, len(self.tree)
        mass = np.array([values[per_joint("mass", row, count)] for row in rows])
        centre, inertia = (
            np.array([[values[name] for name in self._names(row, quantity, components)] for row in rows])
            for quantity, components in (("centre_of_mass", VECTOR), ("inertia", INERTIA))
        )
        for i, row in enumerate(rows):
            inertia[i] *= values.get(per_joint("inertia_scale", row, count), 1.0)
            load = values.get(per_joint("payload_mass", row, count), 0.0)
            if load:
                place, per_mass = (
                    [values.get(name, 0.0) for name in self._names(row, f"payload_{quantity}", components)]
                    for quantity, components in (("centre_of_mass", VECTOR), ("inertia_per_mass", INERTIA))
                )
                link = float(mass[i]), centre[i].copy(), matrix_of(inertia[i])
                mass[i], centre[i], whole = lumped(
                    [link, (load, np.array(place), load * matrix_of(per_mass))]
                )
                inertia[i] = six_of(whole)
        return {"gravity": values["gravity"], "mass": mass, "centre_of_mass": centre, "inertia": inertia}

    # Dynamics -------------------------------------------------------------------------------------
    def fall(self, p: Any) -> tuple[Any, ...]:
        """Acceleration of free fall in the world's frame, m/s²."""
        return tuple(p.gravity * entry if entry else 0.0 for entry in self.down)

    def rigid(self, p: Any) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        """The links as other tools want them: tree, mass (n,), centre of mass (n, 3) and inertia (n, 6)."""
        return self.tree, p.mass, p.centre_of_mass, p.inertia

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any, armature: Any = None) -> Any:
        """q̈1, (n,) of any element; `armature` as for `forward_dynamics`."""
        bodies = bodies_of(*self.rigid(p))
        return np.array(forward_dynamics(self.tree, bodies, q, dq, torque, self.fall(p), armature))

    def torques(self, q: Any, dq: Any, ddq: Any, p: Any) -> Any:
        """M(q) q̈ + C(q, q̇) q̇ + G(q) by the recursive Newton–Euler algorithm, (n,) of any element."""
        return np.array(inverse_dynamics(self.tree, bodies_of(*self.rigid(p)), q, dq, ddq, self.fall(p)))

    def gravity_torque(self, q: Any, p: Any) -> Any:
        """G(q1), (n,), N·m or N, of any element."""
        return self.torques(np.asarray(q), [0.0] * len(self.tree), [0.0] * len(self.tree), p)


#: The links' side of a robot: what it is made of, and how torques move it. Frozen, so that it is a key.
Links = Pendulum | Arm
