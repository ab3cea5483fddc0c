"""Kinds of laws that can be compared, by name: description, sensors, tuned parameters, and how each is made.

The help of the command line has their names from here, so what needs a synthesis is imported late.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from flexhinf.errors import refuse_if
from flexhinf.extensions import Registry
from flexhinf.validation import one_of, unknown_name

if TYPE_CHECKING:
    from flexhinf.arrays import Matrix, Vector
    from flexhinf.design.laws.pose_model import PoseModel
    from flexhinf.plant import Law

#: The design's own law as `flexhinf design` makes it, the reference of the criterion. It is not tuned for the
#: criterion, so it is not ranked; the next one is.
DESIGN = "design"

#: The nonlinear H∞ law, tuned for the criterion as every other law is.
NL_HINF = "nl-hinf"

#: Names of the parameters of a law's estimator: a factor of R^v, and another factor of its level on the velocities of
#: the motors.
ESTIMATOR_NOISE, MOTOR_NOISE = "estimator_noise", "motor_noise"

#: Name of the parameter that is a whole number: the degree of V, up to the largest that the design tries.
DEGREE = "degree"

#: Name of the parameter that is the size of the channels of the tolerances, of the preset robust: a fraction.
CHANNELS = "tolerance_channels"

#: Ends of three ranges: the γ/γ* from which the disturbance is left out (γ = ∞; its weight is then below 1/400 of that
#: at γ*), the size below which there are no channels, and the weight below which velocities have no penalty. So
#: nonlinear H∞ includes the nonlinear LQR and the design's own problem.
INFINITE_GAMMA, NO_CHANNELS, NO_VELOCITY = 20.0, 0.01, 1e-4

#: Values at which a law equals one without these parameters: the real rotor, hardly an integral, γ = ∞, no channels.
CONTAINED = {
    "rotor_inertia": 1.0,
    "integral_rate": 0.02,
    "gamma_ratio": INFINITE_GAMMA,
    CHANNELS: NO_CHANNELS,
}

#: A value within this fraction of the end of its range counts as the end.
ROUNDING = 1e-9

#: Largest degree of V in a name such as ``nl-hinf-4``.
LARGEST_DEGREE = 12


@dataclass(frozen=True)
class TuningParameter:
    """One number that is tuned, on a logarithmic scale."""

    name: str
    label: str
    unit: str
    start: float | None  # of the search; None where `LawFactory.start` has it
    lower: float
    upper: float
    relative: bool = False  # whether the bounds are factors of the start


PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        TuningParameter("bandwidth", "bandwidth", "rad/s", None, 0.1, 20.0, True),
        TuningParameter("damping", "damping ratio", "", 1.0, 0.3, 5.0),
        TuningParameter("integral_rate", "integral's pole / bandwidth", "", None, 0.02, 2.0),
        TuningParameter("rotor_inertia", "rotor inertia felt / real", "", 0.25, 0.05, 1.0),
        TuningParameter("effort", "weight of the input, R2 ×", "", 1.0, 1e-4, 1e3),
        TuningParameter("integral_weight", "weight of the integrals ×", "", 1.0, 0.02, 20.0),
        TuningParameter(
            "velocity_weight",
            f"weight of velocities / positions ({NO_VELOCITY:g}: none)",
            "s",
            0.01,
            NO_VELOCITY,
            1.0,
        ),
        TuningParameter("gamma_ratio", f"γ/γ* ({INFINITE_GAMMA:g}: ∞)", "", None, 1.02, INFINITE_GAMMA),
        TuningParameter(
            CHANNELS, f"channels of the tolerances × ({NO_CHANNELS:g}: none)", "", 1.0, NO_CHANNELS, 1.0
        ),
        TuningParameter(ESTIMATOR_NOISE, "Rᵛ of the estimator ×", "", 1.0, 1e-4, 1e4),
        TuningParameter(MOTOR_NOISE, "Rᵛ of the motors' velocities, also ×", "", 1.0, 1e-3, 1e3),
        TuningParameter(DEGREE, "degree of V", "", None, 2.0, 2.0),
    )
}

#: Parameters of estimators, of linear-quadratic laws and of H∞.
ESTIMATOR = (ESTIMATOR_NOISE, MOTOR_NOISE)
QUADRATIC = ("effort", "integral_weight", "velocity_weight", *ESTIMATOR)
H_INFINITY = ("gamma_ratio", CHANNELS, *QUADRATIC)

#: Sets of sensors that proponents of a law use: encoders on the motors; on the links too; torque sensors in the joints.
MOTOR, BOTH = ("motor_position",), ("link_position", "motor_position")
TORQUE, TORQUE_BOTH = (*MOTOR, "joint_torque"), (*BOTH, "joint_torque")

#: Groups of laws: panels of figures.
ROBUST, LINEAR_QUADRATIC, IN_USE = "H∞ and γ = ∞", "linear-quadratic", "in use today"


@dataclass(frozen=True)
class LawOver:
    """How the gains of a law are made at each pose of a workspace."""

    # (n, 5n): torques per deviation of link positions and velocities, motor positions and velocities, and per integral
    make: Callable[[PoseModel, Mapping[str, Vector]], Matrix]
    names: tuple[str, ...]  # numbers that a user may state
    variants: tuple[dict[str, float], ...] = ({},)  # what else the search chooses from, at each bandwidth
    usual: bool = False  # whether it is compared where no laws are named
    of_states: bool = (
        False  # whether the gains are inputs per state of the model and integral, (n, states + n)
    )


@dataclass(frozen=True)
class LawKind:
    """A law that can be compared."""

    name: str
    description: str
    group: str  # panel of the figure
    source: str  # key into docs/references.bib, or who proposes it
    model: str  # the part of the model that the law itself uses; the estimator has the whole model
    make: Callable[..., Law]  # from the weighted problem and, by name, the other numbers that are tuned
    tuned: tuple[str, ...]  # names of all numbers that its gains are made from, and of R^v of its estimator
    # sets of sensors, of which the best is used; empty: the design's sensors
    sensors: tuple[tuple[str, ...], ...] = ()
    degree: int | None = None  # degree of V; 0 for the design's, or the tuned one; None if there is no V
    linear_estimator: bool = False  # a linear Kalman filter in place of the design's estimator
    over: LawOver | None = None  # its gains over a workspace; None for a law of one pose alone
    own: tuple[TuningParameter, ...] = ()  # those of `tuned` that are no `PARAMETERS`
    place: int = 100  # in lists: the smaller, the earlier
    drives: tuple[str, ...] = ()  # kinds of drives that it is for; empty: all

    def fits(self, drive: str) -> bool:
        """Whether it is for robots with such drives, see `flexhinf.robot.elastic.DRIVES`; all of no drive."""
        return not drive or not self.drives or drive in self.drives

    @property
    def parameters(self) -> tuple[TuningParameter, ...]:
        """The numbers that are searched for."""
        known = PARAMETERS | {parameter.name: parameter for parameter in self.own}
        return tuple(known[name] for name in self.tuned)


#: All laws, by name.
LAWS: Registry[LawKind] = Registry("law", __package__ or "", lambda kind: kind.place)

_WITH_DEGREE = re.compile(rf"{NL_HINF}-(\d+)\Z")


def register(kind: LawKind) -> LawKind:
    """Add a law, and return it.

    Raises `InvalidInput` for a name that is there already or cannot be used, and for a parameter that is not known.
    """
    for name in kind.tuned:
        known = {*PARAMETERS, *(parameter.name for parameter in kind.own)}
        one_of(f"The law {kind.name!r} has a parameter that is not known.", name, known)
    return LAWS.register(kind)


def rivals(drive: str = "") -> tuple[str, ...]:
    """Names of laws that are compared with the design's own law and the same tuned, on drives of a kind."""
    return tuple(name for name, kind in LAWS.items() if name not in (DESIGN, NL_HINF) and kind.fits(drive))


def laws_over(usual: bool = False, drive: str = "") -> dict[str, LawOver]:
    """Laws that can be compared over a workspace on drives of a kind, or the usual ones alone; those in use today are
    first."""
    kinds = sorted((k for k in LAWS.values() if k.fits(drive)), key=lambda kind: kind.group != IN_USE)
    own = {kind.name: kind.over for kind in kinds if kind.over is not None}
    return {name: over for name, over in own.items() if over.usual or not usual}


def law_kind(name: str) -> LawKind:
    """The law of a name. Raises `InvalidInput` for a name that is not known, with the nearest that is."""
    match = _WITH_DEGREE.match(name)
    if match and 2 <= (degree := int(match[1])) <= LARGEST_DEGREE:
        return replace(
            LAWS[NL_HINF],
            name=name,
            source="flexhinf design --degrees",
            tuned=H_INFINITY,
            degree=degree,
            description=f"nonlinear H∞ of degree {degree}: the design's problem, V of that degree",
        )
    if name in LAWS:
        return LAWS[name]
    known = (*LAWS, *(f"{NL_HINF}-{degree}" for degree in range(2, LARGEST_DEGREE + 1)))
    raise unknown_name(f"There is no law {name!r} to compare with.", name, known, f"--laws {NL_HINF},pd")


def law_names(names: Sequence[str] | None = None, drive: str = "") -> tuple[str, ...]:
    """The names of a comparison on drives of a kind, each once: the design's own law and the same tuned, then others.

    Raises `InvalidInput` for a name that is not known, and for a law of other drives.
    """
    wanted = tuple(names) if names else tuple(name for name, kind in LAWS.items() if kind.fits(drive))
    for name in wanted:
        check_drive(law_kind(name), drive)
    return tuple(dict.fromkeys((DESIGN, NL_HINF, *wanted)))


def check_drive(kind: LawKind, drive: str) -> None:
    """Refuse a law of other drives than these."""
    refuse_if(
        not kind.fits(drive),
        f"The law {kind.name!r} is for other drives.",
        f"expected a robot with drive = {' or '.join(map(repr, kind.drives))}, got {drive!r}",
        f"--laws {','.join(list(laws_over(usual=True, drive=drive))[:2])}",
    )


def is_hinf(name: str) -> bool:
    """Whether a law is the design's own or tuned nonlinear H∞; linear H∞ (hinf) counts as a rival."""
    return name in (DESIGN, NL_HINF) or name.startswith(f"{NL_HINF}-")
