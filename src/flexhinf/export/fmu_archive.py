"""The archive of an FMU: a description of its variables, the sources, and the library that this machine's C compiler
makes of them; in the form of FMI 2.0 or 3.0."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import sys
import uuid
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from flexhinf.codegen.c import Real
from flexhinf.export.compiled import shared_library
from flexhinf.export.rendering import c_values, render
from flexhinf.files import check_replaceable, write_file
from flexhinf.validation import checked_path, one_of

DOUBLE = Real("double")

#: What a file is dated in the archive, so that the same model gives the same bytes.
DATE = (2020, 1, 1, 0, 0, 0)

#: Versions of the standard: templates, and the kinds of variables.
FORMS = {
    "2.0": ("fmu2.c", "fmi2.h", "modelDescription.xml", {"Real": "Real", "Integer": "Integer"}),
    "3.0": ("fmu3.c", "fmi3.h", "modelDescription3.xml", {"Real": "Float64", "Integer": "Int32"}),
}

#: Names of processors in FMI 3.0, where they are not Python's.
PROCESSORS = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86", "armv7l": "aarch32"}


@dataclass(frozen=True)
class Variable:
    """A variable of a model; the C has it at its place among those of its kind.

    `starts_from`: Names of the variables that determine an output at the start; None where it is `start` whatever they
    are. Later, no output depends on what is set at the same instant: steps alone change outputs.
    """

    name: str
    causality: Literal["input", "output", "parameter"]
    start: float
    unit: str = ""
    kind: Literal["Real", "Integer", "Boolean"] = "Real"
    about: str = ""
    starts_from: tuple[str, ...] | None = None


def write_fmu(
    path: str | os.PathLike[str],
    name: str,
    about: str,
    period: float,
    variables: Sequence[Variable],
    model: Callable[..., str],
    sources: Mapping[str, str],
    fmi: str,
) -> Path:
    """Write the archive whole.

    `period`: s, smallest communication step; others are whole multiples. `variables`: Those of a kind in the order of
    their places in the C. `model`: The header of the model with a `guid`. `sources`: Further files of C. `fmi`: A key
    of `FORMS`.

    Raises InvalidInput: for another version, a path that cannot be written, or without a C compiler.
    """
    one_of("There is no such version of FMI.", fmi, FORMS, "2.0, which most programs read")
    target, header = checked_path("The FMU", path), f"{name}_model.h"
    check_replaceable(target, "FMU", lambda content: b"modelDescription.xml" in content)
    shell, functions, _, _ = FORMS[fmi]
    contents = (name, about, period, variables, {**sources, header: model(guid="@GUID@")})
    guid = "{" + str(uuid.UUID(hashlib.sha256(repr((contents, fmi)).encode()).hexdigest()[:32])) + "}"
    values = {**c_values(name, DOUBLE), "v": int(fmi[0])}
    own = {**sources, header: model(guid=guid)}
    own[f"{name}_{functions}"] = render(functions, **values)
    own[f"{name}_fmu.c"] = render(shell, **values)
    folder, ending = _place(fmi)
    compiled = [file for file in own if file.endswith(".c")]
    files: dict[str, bytes] = {
        "modelDescription.xml": render(
            FORMS[fmi][2],
            **values,
            guid=guid,
            about=about,
            period=period,
            files=compiled,
            **_description(variables, fmi),
        ).encode(),
        **{f"sources/{file}": code.encode() for file, code in own.items()},
        f"binaries/{folder}/{name}.{ending}": shared_library(own),
    }
    if fmi == "3.0":
        build = render("buildDescription.xml", **values, files=compiled)
        files["sources/buildDescription.xml"] = build.encode()
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for file, content in files.items():
            packed.writestr(zipfile.ZipInfo(file, DATE), content, zipfile.ZIP_DEFLATED)
    write_file(target, "FMU", lambda part: Path(part).write_bytes(archive.getvalue()))
    return target


def _place(fmi: str) -> tuple[str, str]:
    """Folder and ending of this machine's library."""
    systems = {"Darwin": ("darwin", "dylib"), "Windows": ("win", "dll")}
    system, ending = systems.get(platform.system(), ("linux", "so"))
    if fmi == "2.0":
        return system + ("64" if sys.maxsize > 2**32 else "32"), ending
    machine = platform.machine().lower()
    return f"{PROCESSORS.get(machine, machine)}-{'windows' if system == 'win' else system}", ending


def _description(variables: Sequence[Variable], fmi: str) -> dict[str, object]:
    """Variables, units and outputs of modelDescription.xml, in which a variable is known by its place (FMI 2.0) or its
    reference (3.0)."""
    references = _references(variables, fmi)
    ids = {v.name: k + 1 for k, v in enumerate(variables)} if fmi == "2.0" else references
    return {
        "units": sorted({variable.unit for variable in variables if variable.unit}),
        "variables": [_entry(variable, references[variable.name], FORMS[fmi][3]) for variable in variables],
        "outputs": [
            {
                "id": ids[v.name],
                "starts_from": None if v.starts_from is None else sorted(ids[one] for one in v.starts_from),
            }
            for v in variables
            if v.causality == "output"
        ],
    }


def _references(variables: Sequence[Variable], fmi: str) -> dict[str, int]:
    """References by name: in FMI 2.0 each kind counts from zero, in 3.0 they follow each other."""
    chosen: dict[str, int] = {}
    for kind in ("Real", "Integer", "Boolean"):
        first = 0 if fmi == "2.0" else len(chosen)
        names = [variable.name for variable in variables if variable.kind == kind]
        chosen |= {name: first + k for k, name in enumerate(names)}
    return chosen


def _entry(variable: Variable, reference: int, kinds: Mapping[str, str]) -> dict[str, object]:
    """The element of a variable; one that is computed at the start has no start value of its own."""
    kind, causality = variable.kind, variable.causality
    begin = str({"Real": float, "Integer": int, "Boolean": bool}[kind](variable.start)).lower()
    continuous = kind == "Real" and causality == "input"
    computed = variable.starts_from is not None
    facts = {
        "name": variable.name,
        "valueReference": reference,
        "causality": causality,
        "variability": "fixed" if causality == "parameter" else "continuous" if continuous else "discrete",
        "initial": "" if causality == "input" else "calculated" if computed else "exact",
        "description": variable.about,
    }
    value = {"start": "" if computed else begin, "unit": variable.unit}
    return {"kind": kinds.get(kind, kind), "facts": facts, "value": value}
