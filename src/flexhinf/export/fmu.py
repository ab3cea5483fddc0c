"""FMUs for co-simulation (FMI 2.0 or 3.0): a controller, or the plant itself, for Simulink, OpenModelica and others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import casadi
import numpy as np
from markupsafe import Markup

from flexhinf.arrays import Numbers
from flexhinf.codegen.c import Translator
from flexhinf.errors import refuse_if
from flexhinf.export.controller_c import MISSING_LIMIT, ControllerCode, code_of
from flexhinf.export.fmu_archive import DOUBLE, Fmu, FmuVariable, write_fmu
from flexhinf.export.names import checked_identifier
from flexhinf.export.refusals import check_limits
from flexhinf.export.rendering import names_in
from flexhinf.loop import Controller
from flexhinf.loop.controller.options import checked_period
from flexhinf.plant import Plant, sub_steps
from flexhinf.stops import Stop
from flexhinf.validation import real_array, value_text


def export_fmu(
    controller: Controller,
    path: str | os.PathLike[str],
    name: str = "controller",
    fmi: str = "2.0",
    limits: bool = True,
) -> Path:
    """Write a controller as an FMU for co-simulation.

    One communication step is one sample, or several with the inputs held: measurements and commands are read at its
    beginning, and ``u`` after it acts the controller's latency later: with one sample, at the
    step's end. It is what `Controller.may_act` lets act: ``stop`` says why the robot stops, ``power`` whether drives
    may have power. Limits of the input are parameters, and so are what stops the robot, the category of that stop, and
    where the estimate begins, ``start.…``: where the robot is then.

    Parameters
    ----------
    path : path
        Of the file, ``.fmu`` by custom; replaced if it is there.
    name : str
        A C identifier.
    fmi : {"2.0", "3.0"}
        Version of the standard. Variables and results are the same.
    limits : bool
        As for `export_c`.

    Raises InvalidInput: as `export_c`; for another version; or there is no C compiler (``CC``, cc, gcc, clang), or it
    fails.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> import tempfile
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=np.inf), None, 1e-3, 48.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fh.export_fmu(controller, f"{folder}/controller.fmu").name
    'controller.fmu'
    """
    code = code_of(controller, name, "double")
    if limits:
        check_limits(controller)
    c, signals, units = code.controller, code.signals, code.units
    if c.estimator is None:
        measured = np.asarray(c.law.operating_point, dtype=float)[: len(c.measured)]
    else:  # what is measured where the estimate begins
        plant = c.estimator.plant
        assert code.belief is not None
        numbers = code.belief, code.safe_input, plant.parameters.vector()
        measured = np.ravel(np.asarray(plant.traced_output(*numbers), dtype=float))
    belief = code.belief if code.starts_anywhere else None
    y, r, u, x = (signals[kind] for kind in "YRUX")
    starts = [f"start.{name}" for name in (() if belief is None else x)]
    first = np.zeros(len(x)) if belief is None else belief
    fresh = y if c.mode.checks_measurements else ()
    rows = (
        _VariablesOfKind("measured", "input", y, measured),
        _VariablesOfKind("command", "input", r, c.operating_reference),
        _VariablesOfKind("lower", "parameter", u, np.maximum(c.limits.lower, -1e300), "least input"),
        _VariablesOfKind("upper", "parameter", u, np.minimum(c.limits.upper, 1e300), "largest input"),
        _VariablesOfKind(
            "start",
            "parameter",
            x[: len(starts)],
            first[: len(starts)],
            "where the estimate begins: the robot must be there",
        ),
        _VariablesOfKind(
            "u", "output", u, code.safe_input, "", [(f"lower.{name}", f"upper.{name}", *starts) for name in u]
        ),
        _VariablesOfKind("estimate", "output", x, first, "", [(start,) for start in starts]),
    )
    variables = [
        *_variables(rows, lambda name: units.get(name, "")),
        FmuVariable(
            "path_rate", "output", 1.0, about="fraction of a period by which the time along a path advances"
        ),
        FmuVariable(
            "missing_limit",
            "parameter",
            MISSING_LIMIT if code.predicts else 0,
            kind="Integer",
            about="samples without a measurement until the output is held",
        ),
        FmuVariable(
            "stop_on",
            "parameter",
            code.whole_numbers[1],
            kind="Integer",
            about="bits of what stops the robot, as of stop; 0: nothing",
        ),
        FmuVariable(
            "category",
            "parameter",
            code.whole_numbers[2],
            kind="Integer",
            about="of that stop by IEC 60204-1: 0, power off at once; 1, controlled stop, then off; 2, then held",
        ),
        *(
            FmuVariable(
                f"fresh.{name}",
                "input",
                0,
                kind="Integer",
                about="1: measured since the step before; -1: not since then, it counts as missing; 0: not known",
            )
            for name in fresh
        ),
        FmuVariable("code", "output", 0, kind="Integer", about="what the last step returned, 0: all is well"),
        FmuVariable(
            "status",
            "output",
            0,
            kind="Integer",
            about="bits: outside workspace, limit cycle, saturation, reacting, doubtful estimate, following error, "
            "blocked, and the signs of a stop",
        ),
        FmuVariable(
            "stop",
            "output",
            0,
            kind="Integer",
            about=f"why the robot stops, bits: {', '.join(str(stop.name).lower() for stop in Stop)}",
        ),
        *(
            FmuVariable(name, "output", 0, kind="Integer", about=about)
            for name, about in _counts(code).items()
        ),
        FmuVariable("is_measured", "input", 1, kind="Boolean", about="whether there is a measurement"),
        FmuVariable("power", "output", 1, kind="Boolean", about="whether the drives may have power"),
    ]
    values = dict(
        code.values,
        start=code.numbers([variable.start for variable in variables if variable.kind == "Real"], "        "),
        starts=len(starts),
        fresh=len(fresh),
        doubtful=int(code.doubt is not None),
        rejected=0 if code.rejected is None else len(y),
    )
    sources = {f"{code.name}.c": code.source, f"{code.name}.h": code.header}
    about = f"sampled controller of {c.period:g} s. {_start_text(code)}"
    fmu = Fmu(code.name, about, c.period, variables, "fmu_controller.h", values, sources)
    return write_fmu(path, fmu, fmi)


def _start_text(code: ControllerCode) -> str:
    """Where the robot must be at the start of an FMU of the controller, in a sentence or two."""
    if code.belief is None:
        return "It feeds back what is measured, so the robot may be anywhere."
    place = ", ".join(
        f"{name} {value:.6g} {code.units.get(name, '')}".rstrip()
        for name, value in zip(code.signals["X"], code.belief, strict=True)
    )
    rests = f"It believes the robot at rest at {place}. From another place inputs may reach their limits"
    return f"{rests}: set the parameters start.* to where it is." if code.starts_anywhere else f"{rests}."


def _counts(code: ControllerCode) -> dict[str, str]:
    """Names of counts since the start, and what they count."""
    doubt = {"doubtful": "samples at which the estimate was in doubt"} if code.doubt is not None else {}
    outliers: Sequence[str] = () if code.rejected is None else code.signals["Y"]
    return {**doubt, **{f"rejected.{name}": "measurements that the gate rejected" for name in outliers}}


def export_plant_fmu(
    plant: Plant,
    path: str | os.PathLike[str],
    name: str = "plant",
    period: float = 1e-3,
    state: Numbers = None,
    input: Numbers = None,
    fmi: str = "2.0",
) -> Path:
    """Write a plant as an FMU for co-simulation: the elastic robot itself.

    Integrated as in `Loop`, by the classical Runge–Kutta method with as many steps per period as its fastest mode asks
    for. Inputs are those of the motors and the disturbances, outputs the measured signals and the state; the plant's
    parameters and the first state can be set.

    Parameters
    ----------
    path, name, fmi
        As for `export_fmu`.
    period : float
        Smallest communication step, s.
    state, input : (n,) and (m,) arrays, optional
        Initial state, and the input until one is set; zero by default.

    Raises InvalidInput: as `export_fmu`; or the plant is too fast for the period.
    """
    plant.check_continuous("integrator in an FMU")
    start, acting = _start(state, plant.states, "state"), _start(input, plant.inputs, "input")
    name, period = checked_identifier(name), checked_period(period)
    parameters = plant.parameters.vector()
    translator = Translator(name, DOUBLE, taken=names_in("fmu_plant.h", name))
    flow, output = translator.function(plant.traced_flow), translator.function(plant.traced_output)
    sizes = (len(plant.inputs), len(plant.disturbances), len(parameters), plant.n)
    measured = np.ravel(np.asarray(plant.traced_output(start, acting, parameters), dtype=float))
    labels = [  # a name for each number of the parameters, in the order of their vector
        label if np.size(value) == 1 else f"{label}[{k + 1}]"
        for label, value in plant.parameters.values.items()
        for k in range(int(np.size(value)))
    ]
    starts = [f"start.{label}" for label in plant.states]
    rows = (
        _VariablesOfKind("u", "input", plant.inputs, acting),
        _VariablesOfKind("disturbance", "input", plant.disturbances, np.zeros(sizes[1])),
        _VariablesOfKind("parameter", "parameter", labels, parameters),
        _VariablesOfKind("start", "parameter", plant.states, start, "where the robot begins"),
        _VariablesOfKind("measured", "output", plant.outputs, measured, "", _needed(plant, starts, labels)),
        _VariablesOfKind("state", "output", plant.states, start, "", [(label,) for label in starts]),
    )
    variables = _variables(rows, plant.unit)
    steps = sub_steps(period, plant.fastest_mode(start))
    places = ["r + FIRST_U", "r + FIRST_D", "r + FIRST_P"]
    values = {
        "period": repr(period),
        "period_text": f"{period:g}",
        "sub_steps": steps,
        "n": plant.n,
        "m": sizes[0],
        "d": sizes[1],
        "p": sizes[2],
        "y": len(plant.outputs),
        "functions": Markup(translator),
        "flow": _called(flow, plant.traced_flow, ["x", *places], "slope"),
        "output": _called(output, plant.traced_output, ["r + FIRST_X", places[0], places[2]], "r + FIRST_Y"),
        "start": Markup(",\n".join(f"        {variable.start!r}" for variable in variables[: sum(sizes)])),
    }
    about = f"plant in {steps} steps per {period:g} s, which begins where the parameters start.* say"
    return write_fmu(path, Fmu(name, about, period, variables, "fmu_plant.h", values, {}), fmi)


def _needed(plant: Plant, starts: Sequence[str], labels: Sequence[str]) -> list[tuple[str, ...]]:
    """What each measured signal is computed from at the start."""
    kinds = (starts, [f"u.{name}" for name in plant.inputs], [f"parameter.{label}" for label in labels])
    output = plant.traced_output
    needed: list[list[str]] = [[] for _ in plant.outputs]
    for k, names in enumerate(kinds):
        for row, column in zip(*output.jac_sparsity(0, k).get_triplet(), strict=True):
            needed[row].append(names[column])
    return [tuple(names) for names in needed]


def _start(start: Numbers, names: Sequence[str], what: str) -> np.ndarray:
    values = np.zeros(len(names)) if start is None else real_array(start)
    refuse_if(
        values.shape != (len(names),) or not np.isfinite(values).all(),
        f"The first {what} does not fit the plant.",
        f"expected a finite number for each of {list(names)}, got {value_text(start)}",
        f"{what}=None for zeros",
    )
    return values


class _VariablesOfKind(NamedTuple):
    """Variables of a kind: prefix of their names, causality, start values, description, and what each starts from."""

    prefix: str
    causality: Literal["input", "output", "parameter"]
    names: Sequence[str]
    values: Iterable[float]
    about: str = ""
    starts_from: Sequence[tuple[str, ...] | None] | None = None


def _variables(rows: Iterable[_VariablesOfKind], unit: Callable[[str], str]) -> list[FmuVariable]:
    return [
        FmuVariable(
            f"{row.prefix}.{name}",
            row.causality,
            float(value),
            unit(name),
            about=row.about,
            starts_from=known,
        )
        for row in rows
        for name, value, known in zip(
            row.names, row.values, row.starts_from or [None] * len(row.names), strict=True
        )
    ]


def _called(name: str, function: casadi.Function, arguments: Sequence[str], result: str) -> Markup:
    kept = [text for k, text in enumerate(arguments) if function.numel_in(k)]
    return Markup(f"{name}({', '.join([*kept, result])});")
