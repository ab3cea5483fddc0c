"""Laws of a controller: several of one formula, tables, and those of a file; and a controller in one file.

The file is a compressed NumPy archive with a version and without pickles.

The file holds everything that a step needs: the laws (names, operating point, coefficients, and the formula as the
instructions of its traced function where it is no polynomial), the estimator with its settings and the model that it
believes in (the instructions of flow and output, and parameters), period, saturation and options. A loaded law is a
`StoredLaw`: it computes the same numbers, without any data of its design. docs/controller_file.md has the format.
"""

# Laws are checked, since callers may pass anything.
# pyright: reportUnnecessaryIsInstance=false
from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Elements, Numbers
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.extensions import load_extensions
from flexhinf.files import read_arrays, write_arrays
from flexhinf.loop.controller.backlash import Backlash
from flexhinf.loop.controller.friction import DryFriction
from flexhinf.loop.controller.governor import Governor
from flexhinf.loop.controller.options import Windup
from flexhinf.loop.controller.protection import Protection
from flexhinf.loop.controller.status import Supervision
from flexhinf.plant import Estimator, Law, ParameterTable, Plant, StoredCode
from flexhinf.plant.protocols import INTEGRAL
from flexhinf.plant.series import SpringSeries
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.scalars import apply, function_arrays, function_from_arrays, trace
from flexhinf.validation import checked_kind, checked_name, checked_path, distinct, real_number, value_text


class Schedule(Law):
    """Laws at several poses, of which one is active at a time.

    Active is the law whose operating point's tracked positions are nearest (Euclidean distance) to the command.
    It changes only when another law is nearer by the fraction `hysteresis`: distance < (1 − hysteresis) · distance of
    the active law's. At a change the integrals are chosen so that the input continues from the last one, see
    `flexhinf.loop.controller.step`. About a moving reference x_d and u_d are the command's, and only k changes.

    Where one law is needed (names, operating point and input, numbers), it is the first.

    Parameters
    ----------
    laws : sequence of Law
        Of the same states and inputs, and of one formula: solved to the same degree. Degrees that vanish at one
        pose only, by symmetry, do not matter.
    hysteresis : float
        At least 0, below 1.

    Raises
    ------
    InvalidInput
        If the laws do not fit each other, track nothing or share a pose, or the hysteresis is no such number.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> laws = [fh.linear_law(arm.problem(pose=pose), np.inf) for pose in (0.5, 1.0)]
    >>> controller = fh.Controller(fh.Schedule(laws), None, 1e-3)
    >>> len(controller.laws)
    2
    """

    law_data: Any = None
    law_key: Any = ""

    def __init__(self, laws: Sequence[Law], hysteresis: float = 0.1) -> None:
        if not isinstance(laws, Sequence) or isinstance(laws, str) or not laws:
            raise InvalidInput(
                "A schedule needs laws.",
                f"expected a sequence of laws, got {value_text(laws)}",
                "Schedule([law, other])",
            )
        for law in laws:
            check_kinds(law, None)
            first, own = ([list(each.state_names), list(each.input_names)] for each in (laws[0], law))
            if own != first:
                raise InvalidInput(
                    "The laws of a schedule do not mean the same states and inputs.",
                    f"expected {first}, got {own}",
                    "laws of one problem at several poses",
                )
        laws = with_common_monomials(laws)
        text, *others = ((type(law), law.law_key, np.size(law.law_data)) for law in laws)
        for other in others:
            if text != other:
                raise InvalidInput(
                    "The laws of a schedule share no formula.",
                    f"expected {text[0].__name__} {text[1]!r} of {text[2]} numbers, "
                    f"got {other[0].__name__} {other[1]!r} of {other[2]}",
                    "solve all to the same degree",
                )
        places = [laws[0].state_names.index(name) for name in laws[0].tracked]
        poses = [tuple(np.asarray(law.operating_point, dtype=float)[places].tolist()) for law in laws]
        if not places or len(set(poses)) < len(poses):
            raise InvalidInput(
                "The poses of a schedule do not tell its laws apart.",
                f"expected tracked positions that differ, got {[list(pose) for pose in poses]}",
                "laws with integrals, each about a pose of its own",
            )
        self.laws, self.hysteresis = laws, real_number(hysteresis)
        if not 0.0 <= self.hysteresis < 1.0:
            raise InvalidInput(
                "The hysteresis of a schedule is no fraction.",
                f"expected 0 <= number < 1, got {value_text(hysteresis)}",
                "hysteresis=0.1: another law must be nearer by 10 %",
            )
        first = self.laws[0]
        self.state_names, self.input_names = tuple(first.state_names), tuple(first.input_names)
        self.operating_point, self.operating_input = first.operating_point, first.operating_input
        self.law_data, self.law_key = first.law_data, first.law_key

    def acting(self, pose: Numbers) -> int:
        """Place of the law that acts at a pose, the nearest in the tracked positions, without hysteresis.

        Parameters
        ----------
        pose : (n,)
            The first states of the laws, such as all link positions, rad or m; at least up to the tracked ones.
        """
        places = [self.state_names.index(name) for name in self.tracked]
        points = np.array([np.asarray(law.operating_point, dtype=float)[places] for law in self.laws])
        return int(np.argmin(np.linalg.norm(points - np.asarray(pose, dtype=float)[places], axis=1)))

    def evaluate_law(self, x: Elements, data: Elements) -> Elements:
        """k(x), (m,), by the formula that the laws share."""
        return self.laws[0].evaluate_law(x, data)


class StoredLaw(Law):
    """A law that copies names, operating point and numbers of another one, and is the table of its polynomial, or its
    traced functions in `arrays`; one that is `placed` depends on the reference that it acts about.

    `kind` is the class of the other law, `law_degree` the degree of its value function.
    """

    kind: Any = ""
    law_key: Any = ""
    law_data: Any = None
    law_degree: Any = None
    law_table: Any = None
    law_series: Any = None
    _about: Any = None

    def __init__(
        self,
        names: Sequence[Sequence[str]],
        point: Any,
        input: Any,
        data: np.ndarray,
        kind: str,
        degree: int | None,
        arrays: Mapping[str, Any],
        table: PolynomialLaw | None = None,
        placed: bool = False,
        series: SpringSeries | None = None,
    ) -> None:
        self.state_names, self.input_names = map(tuple, names)
        self.operating_point, self.operating_input = point, input
        self.law_data, self.kind, self.law_degree, self.law_table = data, kind, degree, table
        if table is not None:
            self.law_key = f"polynomial {table.n} {table.degrees}"
            return
        if series is not None:
            self.law_series, self.law_key = series, f"series {series.key}"
            return
        n, states, m = len(self.state_names), len(self.plant_states), len(self.input_names)
        self._law = self._function("law", "law.", arrays, [n, data.size])
        if placed:
            self._about = self._function("law_about", "about.", arrays, [n, states, m, data.size])
        code = [name.encode() + arrays[name].tobytes() for name in sorted(arrays) if name.startswith("law.")]
        self.law_key = f"stored {hashlib.sha256(b''.join(code)).hexdigest()}"

    def _function(self, name: str, prefix: str, arrays: Mapping[str, Any], sizes: list[int]) -> Any:
        function = function_from_arrays(_below(prefix, arrays), name)
        lengths = [function.size1_in(k) for k in range(function.n_in())]
        if lengths != sizes or function.n_out() != 1 or function.size1_out(0) != len(self.input_names):
            raise InvalidInput("Another law.", f"expected arguments of {sizes} numbers, got {lengths}")
        return function

    @property
    def depends_on_reference(self) -> bool:
        """Whether it has a function about a reference."""
        return self._about is not None or self.law_series is not None

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,), for a deviation x (n,) on any element."""
        if self.law_series is not None:
            return self.law_series.evaluate(x, data)
        if self.law_table is None:
            return apply(self._law, x, data)[0]
        return self.law_table.evaluate(x, np.asarray(data).reshape(self.law_table.coefficients.shape))

    def evaluate_about(self, x: Any, state: Any, input: Any, data: Any) -> Any:
        """k(x), (m,), about a reference (state, input)."""
        if self.law_series is not None:
            return self.law_series.evaluate(x, data, state)
        placed = self._about is not None
        return apply(self._about, x, state, input, data)[0] if placed else self.evaluate_law(x, data)


def with_common_monomials(laws: Sequence[Law]) -> tuple[Law, ...]:
    """The laws, padded if they are polynomials of one class, solved to one degree, whose monomials differ."""
    alike = len({(type(law), law.law_degree) for law in laws}) == 1 and laws[0].law_degree is not None
    tables = [table for law in laws if (table := law.law_table) is not None]
    if len({law.law_key for law in laws}) == 1 or not alike or len(tables) < len(laws):
        return tuple(laws)
    degrees = tuple(sorted({degree for table in tables for degree in table.degrees}))
    padded: list[StoredLaw] = []
    for law, table in zip(laws, tables):
        own, nothing = iter(table.coefficients.T), np.zeros(len(law.input_names))
        rows = [
            next(own) if degree in table.degrees else nothing
            for degree in degrees
            for _ in range(basis.count(table.n, degree))
        ]
        whole, names = PolynomialLaw(table.n, degrees, np.array(rows).T), (law.state_names, law.input_names)
        ends, data = (law.operating_point, law.operating_input), whole.coefficients.ravel()
        padded.append(StoredLaw(names, *ends, data, law.kind, law.law_degree, {}, whole))
    return tuple(padded)


def check_kinds(law: Any, estimator: Any) -> None:
    """Refuse what is no law with finite numbers of the right sizes, or neither an estimator nor None."""
    checked_kind(
        "The controller needs a law.",
        law,
        Law,
        "a flexhinf.plant.Law",
        "a solution of solve_hji or linear_law, or a subclass of flexhinf.plant.Law",
    )
    checked_kind(
        "The controller's estimator is none.",
        estimator,
        Estimator | None,
        "a flexhinf.plant.Estimator or None",
        "Controller(solution, UnscentedKalmanFilter(...), period)",
    )
    n, m = len(law.state_names), len(law.input_names)
    point, u = np.asarray(law.operating_point), np.asarray(law.operating_input)
    if point.shape != (n,) or u.shape != (m,) or not np.all(np.isfinite(np.ravel(law.law_data))):
        raise InvalidInput(
            "The law's numbers do not fit its names, or are not finite.",
            f"expected an operating point ({n},) and input ({m},), got {point.shape} and {u.shape}",
            "one value per name",
        )


# Files ------------------------------------------------------------------------------------------
FORMAT, VERSION = "flexhinf controller", 1

#: Estimators are made again by the public classes of this room only: a file cannot name, nor import, other code.
ESTIMATORS = "flexhinf.estimation"

#: Other classes that were registered, by module and name: that of an installed package, or of a program's own file.
SAVABLE: dict[str, type[Estimator]] = {}


def _name(kind: type[Estimator]) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def savable_estimator(kind: type[Estimator]) -> None:
    """Let files of controllers name a class of estimators, which is made again by its `settings`.

    Raises `InvalidInput` for a class that does not state them.
    """
    refuse_if(
        kind.settings is Estimator.settings,
        f"{kind.__name__} cannot be saved.",
        "expected a class with the method settings(), which returns the arguments that make it again, got none",
        "def settings(self): return {'plant': self.plant, 'period': self.period, …}",
    )
    SAVABLE[_name(kind)] = kind


#: Most states or inputs of a law that a file may claim.
MOST_SIGNALS = 1000

#: Options of a controller that are several arrays, by the names of these, and others that are arrays.
PAIRS = {
    "saturation": ("lower", "upper"),
    "command_range": ("command_lower", "command_upper"),
    "measurement_limits": ("measurement_lower", "measurement_upper", "measurement_rate"),
}
ARRAYS = ("input_rate", "command_rate", "integral_dead_zone", "before_first")

#: Options that are made of several named ones.
NAMED: dict[str, Callable[..., Any]] = {
    "supervision": Supervision,
    "dry_friction": DryFriction,
    "backlash": Backlash,
    "governor": Governor,
    "protection": Protection,
}

#: Options that have another name in a file.
IN_FILE = {"blend_time": "fade"}

#: What a file without these options means; they are not written.
UNWRITTEN = (("before_first", "hold"), ("latency", 0))

#: Settings of estimators in a file from before there were these settings.
UNSTATED = {name: {"form": "covariance"} for name in ("UnscentedKalmanFilter", "ExtendedKalmanFilter")}


def write_controller(
    path: str | os.PathLike[str],
    law: Law,
    estimator: Estimator | None,
    period: float,
    options: dict[str, Any],
) -> None:
    """Write a controller to a file; `options` are its other arguments by name. See `Controller.save`."""
    laws = law.laws if isinstance(law, Schedule) else (law,)
    arrays: dict[str, np.ndarray] = {}
    plain: dict[str, Any] = {}
    for name, option in options.items():
        if name in PAIRS:
            arrays |= dict(zip(PAIRS[name], option))
        elif isinstance(option, Windup):
            arrays |= _prefixed(f"{name}.", vars(option))
        elif name in NAMED:
            plain[name] = option.settings()
        elif isinstance(option, np.ndarray):
            arrays[name] = option
        elif (name, option) not in UNWRITTEN:
            plain[IN_FILE.get(name, name)] = option
    header = {
        "format": FORMAT,
        "version": VERSION,
        "period": period,
        "options": plain,
        "hysteresis": law.hysteresis if isinstance(law, Schedule) else None,
        "laws": [_store_law(member, f"laws.{k}.", arrays) for k, member in enumerate(laws)],
        "estimator": None if estimator is None else _store(estimator, "estimator.", arrays),
    }
    write_arrays(path, "controller", {"header": np.array(json.dumps(header)), **arrays})


def read_controller(path: str | os.PathLike[str], make: Callable[..., Any]) -> Any:
    """Call `make` (the class `Controller`) with the arguments in a file; see `load_controller`."""
    place = checked_path("The controller's file", path)
    place = place / "controller" if os.path.isdir(place) else place
    try:
        arrays, whole = read_arrays(place)
        if not whole:
            raise InvalidInput("Not whole.", "the digest at its end is missing, or that of another content")
        return make(**_arguments(json.loads(str(arrays.pop("header"))), arrays))
    except MemoryError:
        raise  # the file may be as it should
    except Exception as error:  # a file with a digest may still hold anything
        reason = f"damaged or not such a file ({type(error).__name__})"
        if isinstance(error, FlexhinfError):
            reason = " ".join(filter(None, (error.what, error.found)))
            if not os.path.exists(place):
                raise InvalidInput(
                    f"There is no controller's file {value_text(str(path), 120)}.",
                    "expected a file that Controller.save wrote, got a path where nothing is",
                    "the path of such a file, beginning at the working folder or at the root",
                ) from None
        raise InvalidInput(
            "The controller cannot be read.",
            f"expected a {FORMAT} file, version {VERSION}, got {place}: {reason}",
            "save it again; files are written by Controller.save",
        ) from error


def _arguments(header: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    if header["format"] != FORMAT or header["version"] != VERSION:
        raise InvalidInput(
            "Another format.",
            f"{value_text(header['format'], 60)}, version {value_text(header['version'], 60)}",
        )
    laws = [_stored_law(part, _below(f"laws.{k}.", arrays)) for k, part in enumerate(header["laws"])]
    law = laws[0] if header["hysteresis"] is None else Schedule(laws, header["hysteresis"])
    estimator = None if header["estimator"] is None else _restore(header["estimator"], "estimator.", arrays)
    names = {stored: name for name, stored in IN_FILE.items()}
    return {
        "solution": law,
        "estimator": estimator,
        "period": header["period"],
        **{name: arrays[name] for name in ARRAYS if name in arrays},
        **{name: tuple(arrays[end] for end in ends) for name, ends in PAIRS.items() if ends[0] in arrays},
        **({"windup": Windup(**_below("windup.", arrays))} if "windup.limit" in arrays else {}),
        "latency": 0,
        **{
            str(names.get(name, name)): NAMED[name](**option) if name in NAMED else option
            for name, option in header["options"].items()
        },
    }


def _below(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {name[len(prefix) :]: array for name, array in arrays.items() if name.startswith(prefix)}


# Laws ---------------------------------------------------------------------------------------------
def _store_law(law: Law, prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    n, m, data = len(law.state_names), len(law.input_names), np.ravel(np.asarray(law.law_data, dtype=float))
    parts = {"data": data, "point": law.operating_point, "input": law.operating_input}
    table, series = None if law.depends_on_reference else law.law_table, law.law_series
    try:
        if series is not None:
            parts |= _prefixed("compliance.", function_arrays(series.compliance))
        elif table is None:
            parts |= _prefixed("law.", function_arrays(trace(law.evaluate_law, n, data.size, name="law")))
        if series is None and law.depends_on_reference:
            about = trace(law.evaluate_about, n, len(law.plant_states), m, data.size, name="law_about")
            parts |= _prefixed("about.", function_arrays(about))
    except Exception as error:  # a law's code may be anybody's
        raise InvalidInput(
            f"{type(law).__name__} cannot be saved.",
            f"expected a law whose formula runs on symbols, got {type(error).__name__}: {error}",
            "NumPy code with the pieces of flexhinf.scalars",
        ) from error
    found = None if series is None else {"poles": series.poles, "places": series.places.tolist()}
    if series is not None and series.holding:
        found = {**(found or {}), "holding": True}
    if series is not None and series.coupling is not None:
        found = {**(found or {}), "coupling": series.coupling.tolist()}
    arrays |= _prefixed(prefix, {name: np.asarray(part) for name, part in parts.items()})
    return {
        "name": law.kind,
        "degree": law.law_degree,
        "states": list(law.state_names),
        "inputs": list(law.input_names),
        "degrees": None if table is None else list(table.degrees),
        "placed": law.depends_on_reference,
        "series": found,
    }


def _stored_law(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Law:
    """A law from a file. Its functions are built now, so that arrays that are no functions of these states and inputs
    are refused at once: by an InvalidInput, ValueError, IndexError or KeyError."""
    every: list[tuple[str, ...]] = []
    for kind in ("states", "inputs"):
        names = cast("list[Any]", header[kind])  # a text would be taken for a list of letters
        if not isinstance(names, list) or not 0 < len(names) <= MOST_SIGNALS:
            raise InvalidInput("A law's signals are not named.", f"got {value_text(names, 60)}")
        every.append(tuple(checked_name("a signal of a law", name, spaces=True) for name in names))
        distinct("The signal", every[-1])
    states, inputs = every
    for name, shape in {"point": (len(states),), "input": (len(inputs),), "data": None}.items():
        array = arrays[name]
        right = array.ndim == 1 if shape is None else array.shape == shape
        if array.dtype != np.float64 or not right or not np.isfinite(array).all():
            raise InvalidInput(
                "Wrong numbers.", f"{name} of a law is no vector of finite numbers that fits it"
            )
    ends, kind = (arrays["point"], arrays["input"]), str(header["name"])
    parts = (states, inputs), *ends, arrays["data"], kind, header["degree"], arrays
    if header.get("series"):
        return StoredLaw(*parts, series=_stored_series(header["series"], arrays, (states, inputs)))
    if header["degrees"] is None:
        return StoredLaw(*parts, placed=header["placed"])
    if header["placed"]:
        raise InvalidInput("Another law.", "expected no degrees of a law that depends on its reference")
    table = PolynomialLaw(len(states), tuple(header["degrees"]), arrays["data"].reshape(len(inputs), -1))
    law = StoredLaw(*parts, table)
    law.evaluate_law(np.zeros(len(states)), arrays["data"])
    return law


def _stored_series(
    header: dict[str, Any], arrays: dict[str, np.ndarray], names: Sequence[Sequence[str]]
) -> SpringSeries:
    """A modal law's sum from a file; one that does not fit the signals or the numbers is refused."""
    states, inputs = (len(each) for each in names)
    own = sum(not name.endswith(INTEGRAL) for name in names[0])
    places, poles = np.array(header["places"], dtype=np.int64), int(header["poles"])
    compliance = function_from_arrays(_below("compliance.", arrays), "compliance")
    turned = np.array(_rows(header.get("coupling"), inputs)) if "coupling" in header else None
    series = SpringSeries(compliance, places, poles, header.get("holding") is True, turned)
    fits = (
        poles > 0
        and places.shape == (4, inputs)
        and ((places >= 0) & (places < own)).all()
        and states == own + inputs
        and (compliance.n_in(), compliance.n_out()) == (2, 1)
        and (compliance.size1_in(0), compliance.size1_out(0)) == (inputs, inputs**2)
        and sum(series.sizes) + own + inputs == arrays["data"].size
    )
    if not fits:
        raise InvalidInput("Another law.", "expected springs in series that fit the signals and numbers")
    return series


def _rows(stated: Any, size: int) -> tuple[tuple[float, ...], ...]:
    """T (n, n) of coupled joints from a file; without rows where it states none."""
    if stated is None:
        return ()
    matrix = np.array(stated, dtype=float)
    if matrix.shape != (size, size) or not np.isfinite(np.linalg.cond(matrix)):
        raise InvalidInput("Another coupling.", f"expected {size} rows with an inverse")
    return tuple(tuple(row) for row in matrix.tolist())


def _prefixed(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {f"{prefix}{name}": array for name, array in arrays.items()}


# Estimators and their models ----------------------------------------------------------------------
def _store(value: Any, prefix: str, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, Estimator):
        kind = type(value)
        if getattr(import_module(ESTIMATORS), kind.__name__, None) is not kind and _name(kind) not in SAVABLE:
            raise InvalidInput(
                f"{kind.__name__} cannot be saved.",
                "expected an estimator of flexhinf.estimation: a file names no other code",
                "a controller without it, or with one of these",
            )
        settings = {k: _store(part, f"{prefix}{k}.", arrays) for k, part in value.settings().items()}
        return {"estimator": [kind.__module__, kind.__qualname__], "settings": settings}
    if isinstance(value, Plant):
        arrays |= _prefixed(f"{prefix}flow.", function_arrays(value.traced_flow))
        arrays |= _prefixed(f"{prefix}output.", function_arrays(value.traced_output))
        arrays |= _prefixed(f"{prefix}parameters.", value.parameters.values)
        return {
            "plant": {
                **{
                    kind: list(getattr(value, kind))
                    for kind in ("states", "inputs", "disturbances", "outputs")
                },
                "parameters": list(value.parameters.names),
                "units": dict(value.units),
                "groups": {name: list(members) for name, members in value.groups.items()},
                "limits": {name: list(ends) for name, ends in value.limits.items()},
                **({"sampled": True} if value.sampled else {}),
                **({"angles": list(value.angles)} if value.angles else {}),
                **({"coupling": [list(row) for row in value.coupling]} if value.coupling else {}),
            }
        }
    if isinstance(value, np.ndarray):
        arrays[f"{prefix}array"] = value
        return {"array": True}
    return {"value": value}


def _restore(part: dict[str, Any], prefix: str, arrays: Mapping[str, np.ndarray]) -> Any:
    if "estimator" in part:
        place, name = part["estimator"]
        room, full = import_module(ESTIMATORS), f"{place}.{name}"
        kind = getattr(room, name) if name in room.__all__ else None
        if kind is None:
            load_extensions()
            kind = SAVABLE.get(full)
        if not (isinstance(kind, type) and issubclass(kind, Estimator)):
            raise InvalidInput("No estimator.", value_text(name, 60))
        settings = {k: _restore(value, f"{prefix}{k}.", arrays) for k, value in part["settings"].items()}
        return kind(**{**UNSTATED.get(name, {}), **settings})
    if "plant" in part:  # whose flow and output are the stored functions
        header, arrays = part["plant"], _below(prefix, arrays)
        table = ParameterTable({name: arrays[f"parameters.{name}"] for name in header["parameters"]})
        flow, output = (StoredCode(_below(f"{name}.", arrays), table) for name in ("flow", "output"))
        return Plant(
            flow,
            output,
            header["states"],
            header["inputs"],
            header["disturbances"],
            table,
            header["outputs"],
            header["units"],
            header["groups"],
            {name: tuple(ends) for name, ends in header["limits"].items()},
            sampled=header.get("sampled", False),
            angles=header.get("angles", ()),
            coupling=_rows(header.get("coupling"), len(header["inputs"])),
        )
    return arrays[f"{prefix}array"] if "array" in part else part["value"]
