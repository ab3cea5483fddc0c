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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import quoteattr

from flexhinf import __version__
from flexhinf.codegen.c import Real
from flexhinf.export.compiled import shared_library
from flexhinf.export.filling import fill, template
from flexhinf.files import check_replaceable, write_file
from flexhinf.validation import checked_path, one_of

DOUBLE = Real("double")

#: What a file is dated in the archive, so that the same model gives the same bytes.
DATE = (2020, 1, 1, 0, 0, 0)

#: Versions of the standard, and what is called differently in them: templates, and the kinds of variables.
FORMS = {
    "2.0": ("fmu2.c", "fmi2.h", "modelDescription.xml", {"Real": "Real", "Integer": "Integer"}),
    "3.0": ("fmu3.c", "fmi3.h", "modelDescription3.xml", {"Real": "Float64", "Integer": "Int32"}),
}

#: Marks of what the shells share: names and arguments in each version.
SHARED = {
    "2.0": {"V": "2", "INSTANCE": "Component", "STATE": "FMUstate", "TOKEN": "GUID", "VALUES": "", "OTHER_COUNT": ""},
    "3.0": {"V": "3", "INSTANCE": "Instance", "STATE": "FMUState", "TOKEN": "instantiation token",
            "VALUES": ", size_t values", "OTHER_COUNT": "values != count || "},
}  # fmt: skip

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
    path: str | os.PathLike[str], name: str, about: str, period: float, variables: Sequence[Variable],
    sources: Mapping[str, str], fmi: str,
) -> Path:  # fmt: skip
    """Write the archive whole.

    `period`: s, smallest communication step; others are whole multiples. `variables`: Those of a kind in the order of
    their places in the C. `sources`: Files of C without the shell of the standard. `fmi`: A key of `FORMS`.

    Raises InvalidInput: for another version, a path that cannot be written, or without a C compiler.
    """
    one_of("There is no such version of FMI.", fmi, FORMS, "2.0, which most programs read")
    target, model = checked_path("The FMU", path), (name, about, period, variables, dict(sources))
    check_replaceable(target, "FMU", lambda content: b"modelDescription.xml" in content)
    shell, functions, _, _ = FORMS[fmi]
    guid = "{" + str(uuid.UUID(hashlib.sha256(repr((model, fmi)).encode()).hexdigest()[:32])) + "}"
    header = f"{name}_model.h"  # has the mark; other files have names of users
    own = {**sources, header: sources[header].replace("@GUID@", guid)}
    own[f"{name}_{functions}"] = fill(template(functions), name, DOUBLE)
    marks: dict[str, Any] = {"SHARED": template("fmu_shared.c"), "VERSION": __version__, **SHARED[fmi]}
    own[f"{name}_fmu.c"] = fill(template(shell), name, DOUBLE, **marks)
    folder, ending = _place(fmi)
    compiled = [file for file in own if file.endswith(".c")]
    files: dict[str, bytes] = {
        "modelDescription.xml": _description(name, about, period, variables, compiled, guid, fmi).encode(),
        **{f"sources/{file}": code.encode() for file, code in own.items()},
        f"binaries/{folder}/{name}.{ending}": shared_library(own),
    }
    if fmi == "3.0":
        listed = "\n".join(f'      <SourceFile name="{file}"/>' for file in compiled)
        build = fill(template("buildDescription.xml"), name, DOUBLE, FILES=listed)
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


def _description(
    name: str, about: str, period: float, variables: Sequence[Variable], files: Sequence[str], guid: str, fmi: str
) -> str:  # fmt: skip
    """modelDescription.xml, in which a variable is known by its place (FMI 2.0) or its reference (3.0)."""
    kinds, old = FORMS[fmi][3], fmi == "2.0"
    references = _references(variables, fmi)
    ids = {variable.name: k + 1 if old else references[variable.name] for k, variable in enumerate(variables)}
    outputs = [variable for variable in variables if variable.causality == "output"]
    units = sorted({variable.unit for variable in variables if variable.unit})
    indent = "    " if old else "  "
    known = "Unknown index" if old else "{} valueReference"
    return fill(
        template(FORMS[fmi][2]), name, DOUBLE, GUID=guid, VERSION=__version__,
        FILES="\n".join(f'      <File name="{file}"/>' for file in files), PERIOD=repr(period),
        OUTPUTS="\n".join(
            f'  {indent}<{known.format("Output")}="{ids[variable.name]}" dependencies=""/>' for variable in outputs
        ),
        FIRST="\n".join(
            f'  {indent}<{known.format("InitialUnknown")}="{ids[variable.name]}" '
            f'dependencies="{" ".join(map(str, sorted(ids[one] for one in variable.starts_from)))}"/>'
            for variable in outputs if variable.starts_from is not None
        ),
        TIME=len(variables),
        users={
            "ABOUT": quoteattr(about),
            "UNITS": "\n".join([
                "  <UnitDefinitions>", *(f"    <Unit name={quoteattr(unit)}/>" for unit in units),
                "  </UnitDefinitions>", "",
            ]) if units else "",
            "VARIABLES": "\n".join(
                _entry(variable, references[variable.name], kinds, old) for variable in variables
            ),
        },
    )  # fmt: skip


def _references(variables: Sequence[Variable], fmi: str) -> dict[str, int]:
    """References by name: in FMI 2.0 each kind counts from zero, in 3.0 they follow each other."""
    chosen: dict[str, int] = {}
    for kind in ("Real", "Integer", "Boolean"):
        first = 0 if fmi == "2.0" else len(chosen)
        names = [variable.name for variable in variables if variable.kind == kind]
        chosen |= {name: first + k for k, name in enumerate(names)}
    return chosen


def _entry(variable: Variable, reference: int, kinds: Mapping[str, str], old: bool) -> str:
    """The element of a variable; one that is computed at the start has no start value of its own."""
    kind, causality = variable.kind, variable.causality
    begin = str({"Real": float, "Integer": int, "Boolean": bool}[kind](variable.start)).lower()
    continuous = kind == "Real" and causality == "input"
    variability = "fixed" if causality == "parameter" else "continuous" if continuous else "discrete"
    computed = variable.starts_from is not None
    facts: dict[str, Any] = {
        "name": variable.name, "valueReference": reference, "causality": causality, "variability": variability,
        "initial": "" if causality == "input" else "calculated" if computed else "exact",
        "description": variable.about,
    }  # fmt: skip
    value = {"start": "" if computed else begin, "unit": variable.unit}
    element = kinds.get(kind, kind)
    if old:
        return f"    <ScalarVariable {_attributes(facts)}><{element} {_attributes(value)}/></ScalarVariable>"
    return f"    <{element} {_attributes({**facts, **value})}/>"


def _attributes(values: Mapping[str, Any]) -> str:
    return " ".join(f"{key}={quoteattr(str(value))}" for key, value in values.items() if value != "")
