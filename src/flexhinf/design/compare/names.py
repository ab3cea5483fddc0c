"""The laws that can be compared, by name: what each is, and the one number that is tuned."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from flexhinf.errors import InvalidInput

__all__ = ["BANDWIDTH", "DEFAULT_LAWS", "PRICE", "REFERENCE", "Kind", "kind_of", "law_names"]

#: What is turned: the price of the input, R2 = k × the design's, or the bandwidth that the gains are made from.
PRICE, BANDWIDTH = "price of the input", "bandwidth"

#: The design's own law: all others are tuned to it.
REFERENCE = "nl-hinf"

#: Highest degree of V in a name.
MOST = 12


@dataclass(frozen=True)
class Kind:
    """What a name stands for.

    Attributes
    ----------
    name : str
    what : str
    group : str
        Which panel of the figure it is in.
    knob : {PRICE, BANDWIDTH}
    source : str
    model : str
        What the law itself has to know of the robot; the estimator knows the whole model.
    integral : bool
        Whether it integrates the error of the link positions.
    """

    name: str
    what: str
    group: str
    knob: str
    source: str
    model: str
    integral: bool = True


_ROBUST, _QUADRATIC, _USUAL = "H∞ and γ = ∞", "linear-quadratic", "in use today"

_KINDS = (
    Kind(REFERENCE, "the design's own nonlinear H∞ law", _ROBUST, PRICE, "flexhinf design", "whole model"),
    Kind("hinf", "linear H∞: degree 2 of the same game", _ROBUST, PRICE, "van der Schaft 1992", "linear at the goal"),
    Kind("nlqr", "nonlinear LQR: γ = ∞, the same degree", _ROBUST, PRICE, "Al'brekht 1961", "whole model"),
    Kind("lqr", "LQR, the same weights", _QUADRATIC, PRICE, "Anderson & Moore 1990", "linear at the goal"),
    Kind(
        "lqr-gravity", "LQR of the weightless robot, weight compensated at every pose", _QUADRATIC, PRICE,
        "Anderson & Moore 1990", "linear, and gravity",
    ),
    Kind(
        "lqg", "LQR with a linear Kalman filter instead of the estimator", _QUADRATIC, PRICE,
        "Anderson & Moore 1990", "linear at the goal",
    ),
    Kind(
        "pd", "PD on the motor side, weight at the goal compensated", _USUAL, BANDWIDTH, "Tomei 1991",
        "inertia, gravity at the goal", False,
    ),
    Kind(
        "pid", "the same with the integral of the link's error", _USUAL, BANDWIDTH, "Tomei 1991, with an integral",
        "inertia, gravity at the goal",
    ),
    Kind(
        "torque", "PD with feedback of the spring's torque, weight compensated from the motor", _USUAL, BANDWIDTH,
        "Albu-Schäffer, Ott & Hirzinger 2007", "inertia, stiffness, gravity", False,
    ),
    Kind(
        "torque-i", "the same with the integral of the link's error", _USUAL, BANDWIDTH,
        "Albu-Schäffer, Ott & Hirzinger 2007, with an integral", "inertia, stiffness, gravity",
    ),
    Kind(
        "flatness", "feedback linearisation with flatness feedforward", _USUAL, BANDWIDTH,
        "Spong 1987; De Luca & Book 2016", "whole model and its derivatives", False,
    ),
    Kind(
        "flatness-i", "the same with the integral of the link's error", _USUAL, BANDWIDTH,
        "Spong 1987; De Luca & Book 2016, with an integral", "whole model and its derivatives",
    ),
)  # fmt: skip

_BY_NAME = {kind.name: kind for kind in _KINDS}
_DEGREE = re.compile(rf"{REFERENCE}-(\d+)\Z")

#: Without a choice: every law as its source has it, and the PD with the integral that practice adds.
DEFAULT_LAWS = (REFERENCE, "hinf", "nlqr", "lqr", "lqr-gravity", "lqg", "pd", "pid", "torque", "flatness")


def degree_of(name: str) -> int | None:
    """Degree of V in a name like ``nl-hinf-4``; None for another name."""
    match = _DEGREE.match(name)
    return int(match[1]) if match else None


def kind_of(name: str) -> Kind:
    """What a name stands for.

    Raises
    ------
    InvalidInput
        For a name that is not known, with the nearest that is.
    """
    degree = degree_of(name)
    if degree is not None and 2 <= degree <= MOST:
        what = f"nonlinear H∞ of degree {degree}: the design's game, V of that degree"
        return Kind(name, what, _ROBUST, PRICE, "flexhinf design --degrees", "whole model")
    if name in _BY_NAME:
        return _BY_NAME[name]
    near = get_close_matches(name, [*_BY_NAME, f"{REFERENCE}-4"], 1, 0.4)
    raise InvalidInput(
        f"There is no law {name!r} to compare with.",
        f"expected names out of {', '.join(_BY_NAME)}, or {REFERENCE}-2 to {REFERENCE}-{MOST}; got {name!r}",
        near[0] if near else "--laws " + ",".join((REFERENCE, "pd")),
    )


def law_names(asked: Sequence[str] | None = None) -> tuple[str, ...]:
    """The names of a comparison, the reference first, each once.

    Raises
    ------
    InvalidInput
        For a name that is not known.
    """
    names = DEFAULT_LAWS if not asked else tuple(asked)
    for name in names:
        kind_of(name)
    return (REFERENCE, *dict.fromkeys(name for name in names if name != REFERENCE))
