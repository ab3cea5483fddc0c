"""FMUs of FMI 2.0 for co-simulation: a controller, or the plant itself, for Simulink, OpenModelica and others.

An FMU is an archive: a description of its variables, the sources, and the library that this machine's C compiler makes
of them.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import sys
import uuid
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import Real, Translator
from flexhinf.errors import refuse_if
from flexhinf.export.compiled import shared_library
from flexhinf.export.controller_c import (
    MISSING_LIMIT,
    arithmetic,
    checked_identifier,
    code_of,
    fill,
    template,
)
from flexhinf.files import write_file
from flexhinf.loop import Controller
from flexhinf.loop.controller.options import checked_period
from flexhinf.plant import Plant, sub_steps
from flexhinf.validation import checked_path, real_array, value_text

DOUBLE = Real("double")

#: What a file is dated in the archive, so that the same model gives the same bytes.
DATE = (2020, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Variable:
    """A variable of a model; its reference is its place among those of its kind."""

    name: str
    causality: Literal["input", "output", "parameter"]
    start: float
    unit: str = ""
    kind: Literal["Real", "Integer", "Boolean"] = "Real"
    about: str = ""


def export_fmu(controller: Controller, path: str | os.PathLike[str], name: str = "controller") -> Path:
    """Write a controller as an FMU for co-simulation (FMI 2.0).

    One communication step is one sample, or several with the inputs held: measurements and commands are read at its
    beginning, and ``u`` after it acts the controller's latency later: with one sample, at the
    step's end. Limits of the input are parameters, and so is where the estimate begins, ``start.…``: where the robot is
    then.

    Parameters
    ----------
    path : path
        Of the file, ``.fmu`` by custom; replaced if it is there.
    name : str
        A C identifier.

    Raises InvalidInput: as `export_c`; or there is no C compiler (``CC``, cc, gcc, clang), or it fails.
    """
    code = code_of(controller, name, "double")
    c, signals, units = code.controller, code.signals, code.units
    if c.estimator is None:
        measured = np.asarray(c.law.operating_point, dtype=float)[: len(c.measured)]
    else:  # what is measured where the estimate begins
        plant = c.estimator.plant
        output = plant.traced_output(code.belief, code.safe_input, plant.parameters.vector())
        measured = np.ravel(np.asarray(output, dtype=float))
    belief = code.belief if code.starts_anywhere else None
    y, r, u, x = (signals[kind] for kind in "YRUX")
    rows = (
        ("measured", "input", y, measured, ""),
        ("command", "input", r, c.operating_reference, ""),
        ("lower", "parameter", u, np.maximum(c.limits.lower, -1e300), "least input"),
        ("upper", "parameter", u, np.minimum(c.limits.upper, 1e300), "largest input"),
        ("start", "parameter", () if belief is None else x, () if belief is None else belief,
         "where the estimate begins"),
        ("u", "output", u, code.safe_input, ""),
        ("estimate", "output", x, np.zeros(len(x)), ""),
    )  # fmt: skip
    variables = [
        *_variables(rows, lambda name: units.get(name, "")),
        Variable(
            "path_rate", "output", 1.0, about="fraction of a period by which the time along a path advances"
        ),
        Variable(
            "missing_limit",
            "parameter",
            MISSING_LIMIT if code.predicts else 0,
            kind="Integer",
            about="samples without a measurement until the output is held",
        ),
        Variable("code", "output", 0, kind="Integer", about="what the last step returned, 0: all is well"),
        Variable(
            "status",
            "output",
            0,
            kind="Integer",
            about="bits: outside workspace, limit cycle, saturation, reacting",
        ),
        Variable("is_measured", "input", 1, kind="Boolean", about="whether there is a measurement"),
    ]
    model = fill(
        template("fmu_controller.h"), code.name, DOUBLE,
        PERIOD=repr(c.period), PERIOD_TEXT=f"{c.period:g}",
        START=code.numbers([variable.start for variable in variables if variable.kind == "Real"], "        "),
        STARTS=0 if belief is None else len(belief),
    )  # fmt: skip
    sources = {f"{code.name}.c": code.source, f"{code.name}.h": code.header, f"{code.name}_model.h": model}
    return _write(path, code.name, f"sampled controller of {c.period:g} s", c.period, variables, sources)


def export_plant_fmu(
    plant: Plant,
    path: str | os.PathLike[str],
    name: str = "plant",
    period: float = 1e-3,
    state: Any = None,
    input: Any = None,
) -> Path:
    """Write a plant as an FMU for co-simulation (FMI 2.0): the elastic robot itself.

    Integrated as in `Loop`, by the classical Runge–Kutta method with as many steps per period as its fastest mode asks
    for. Inputs are those of the motors and the disturbances, outputs the measured signals and the state; the plant's
    parameters and the first state can be set.

    Parameters
    ----------
    path, name
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
    translator = Translator(name, DOUBLE)
    flow, output = translator.function(plant.traced_flow), translator.function(plant.traced_output)
    sizes = (len(plant.inputs), len(plant.disturbances), len(parameters), plant.n)
    measured = np.ravel(np.asarray(plant.traced_output(start, acting, parameters), dtype=float))
    labels = [  # a name for each number of the parameters, in the order of their vector
        label if np.size(value) == 1 else f"{label}[{k + 1}]"
        for label, value in plant.parameters.values.items()
        for k in range(int(np.size(value)))
    ]
    rows = (
        ("u", "input", plant.inputs, acting, ""),
        ("disturbance", "input", plant.disturbances, np.zeros(sizes[1]), ""),
        ("parameter", "parameter", labels, parameters, ""),
        ("start", "parameter", plant.states, start, ""),
        ("measured", "output", plant.outputs, measured, ""),
        ("state", "output", plant.states, start, ""),
    )
    variables = _variables(rows, plant.unit)
    steps = sub_steps(period, plant.fastest_mode(start))
    places = ["r + FIRST_U", "r + FIRST_D", "r + FIRST_P"]
    model = fill(
        template("fmu_plant.h"), name, DOUBLE,
        ARITHMETIC=arithmetic(name, DOUBLE), PERIOD=repr(period), PERIOD_TEXT=f"{period:g}", SUB_STEPS=steps,
        N=plant.n, M=sizes[0], D=sizes[1], P=sizes[2], Y=len(plant.outputs), FUNCTIONS=str(translator),
        FLOW=_called(flow, plant.traced_flow, ["x", *places], "slope"),
        OUTPUT=_called(output, plant.traced_output, ["r + FIRST_X", places[0], places[2]], "r + FIRST_Y"),
        START=",\n".join(f"        {variable.start!r}" for variable in variables[: sum(sizes)]),
    )  # fmt: skip
    about = f"plant in {steps} steps per {period:g} s"
    return _write(path, name, about, period, variables, {f"{name}_model.h": model})


def _start(start: Any, names: Sequence[str], what: str) -> np.ndarray:
    values = np.zeros(len(names)) if start is None else real_array(start)
    refuse_if(
        values.shape != (len(names),) or not np.isfinite(values).all(),
        f"The first {what} does not fit the plant.",
        f"expected a finite number for each of {list(names)}, got {value_text(start)}",
        f"{what}=None for zeros",
    )
    return values


def _variables(rows: Iterable[tuple[Any, ...]], unit: Callable[[str], str]) -> list[Variable]:
    return [
        Variable(f"{prefix}.{name}", causality, float(value), unit(name), about=about)
        for prefix, causality, names, values, about in rows
        for name, value in zip(names, values, strict=True)
    ]


def _called(name: str, function: Any, arguments: Sequence[str], result: str) -> str:
    kept = [text for k, text in enumerate(arguments) if function.numel_in(k)]
    return f"{name}({', '.join([*kept, result])});"


# The archive ------------------------------------------------------------------------------------------
def _write(
    path: str | os.PathLike[str], name: str, about: str, period: float, variables: Sequence[Variable],
    sources: dict[str, str],
) -> Path:  # fmt: skip
    # period, s: smallest communication step, others are whole multiples; variables: those of a kind in the order of
    # their references; sources: files of C without the shell
    target, model = checked_path("The FMU", path), (name, about, period, variables, sources)
    guid = "{" + str(uuid.UUID(hashlib.sha256(repr(model).encode()).hexdigest()[:32])) + "}"
    own = [file for file in (f"{name}.c",) if file in sources]
    text = _description(name, about, period, variables, [*own, f"{name}_fmu.c"], guid)
    sources = {file: code.replace("@GUID@", guid) for file, code in sources.items()}
    sources[f"{name}_fmi2.h"] = fill(template("fmi2.h"), name, DOUBLE)
    sources[f"{name}_fmu.c"] = fill(template("fmu.c"), name, DOUBLE, VERSION=__version__)
    system = {"Darwin": ("darwin", "dylib"), "Windows": ("win", "dll")}
    short, ending = system.get(platform.system(), ("linux", "so"))
    folder = short + ("64" if sys.maxsize > 2**32 else "32")
    files: dict[str, bytes] = {
        "modelDescription.xml": text.encode(),
        **{f"sources/{file}": code.encode() for file, code in sources.items()},
        f"binaries/{folder}/{name}.{ending}": shared_library(sources),
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for file, content in files.items():
            packed.writestr(zipfile.ZipInfo(file, DATE), content, zipfile.ZIP_DEFLATED)
    write_file(target, "FMU", lambda part: Path(part).write_bytes(archive.getvalue()))
    return target


def _description(
    name: str, about: str, period: float, variables: Sequence[Variable], files: Sequence[str], guid: str
) -> str:
    references, entries = {"Real": 0, "Integer": 0, "Boolean": 0}, []
    for variable in variables:
        kind, parameter = variable.kind, variable.causality == "parameter"
        start = str({"Real": float, "Integer": int, "Boolean": bool}[kind](variable.start)).lower()
        continuous = kind == "Real" and variable.causality == "input"
        variability = "fixed" if parameter else "continuous" if continuous else "discrete"
        initial = "" if variable.causality == "input" else ' initial="exact"'
        unit = f" unit={quoteattr(variable.unit)}" if variable.unit else ""
        stated = f" description={quoteattr(variable.about)}" if variable.about else ""
        entries.append(
            f'    <ScalarVariable name={quoteattr(variable.name)} valueReference="{references[kind]}" '
            f'causality="{variable.causality}" variability="{variability}"{initial}{stated}>'
            f'<{kind} start="{start}"{unit}/></ScalarVariable>'
        )
        references[kind] += 1
    units = sorted({variable.unit for variable in variables if variable.unit})
    named = [f"    <Unit name={quoteattr(unit)}/>" for unit in units]
    outputs = [k for k, variable in enumerate(variables, 1) if variable.causality == "output"]
    return fill(
        template("modelDescription.xml"), name, DOUBLE, GUID=guid, VERSION=__version__,
        FILES="\n".join(f'      <File name="{name}"/>' for name in files), PERIOD=repr(period),
        UNITS="\n".join(["  <UnitDefinitions>", *named, "  </UnitDefinitions>", ""]) if units else "",
        OUTPUTS="\n".join(f'      <Unknown index="{k}"/>' for k in outputs), ABOUT=quoteattr(about),
        VARIABLES="\n".join(entries),
    )  # fmt: skip
