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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from flexhinf.codegen.c import Real
from flexhinf.export.compiled import shared_library
from flexhinf.export.file_list import File, rendered
from flexhinf.files import check_replaceable, write_file
from flexhinf.validation import checked_path, one_of

DOUBLE = Real("double")

#: What a file is dated in the archive, so that the same model gives the same bytes.
DATE = (2020, 1, 1, 0, 0, 0)

#: Names of processors in FMI 3.0, where they are not Python's.
PROCESSORS = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86", "armv7l": "aarch32"}


@dataclass(frozen=True)
class FmuVariable:
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


@dataclass(frozen=True)
class Fmu:
    """What the files of an FMU are made of.

    `about`: A sentence on the model. `period`: s, smallest communication step; others are whole multiples. `variables`:
    Those of a kind in the order of their places in the C. `header`: The template of the model's header, and `values`
    what that needs. `sources`: Further files of C. `guid`: What tells it from others.
    """

    name: str
    about: str
    period: float
    variables: Sequence[FmuVariable]
    header: str
    values: Mapping[str, object]
    sources: Mapping[str, str]
    guid: str = "@GUID@"

    @property
    def model(self) -> File[Fmu]:
        """The header of the model."""
        return File("@{name}_model.h", self.header, lambda fmu: {**fmu.values, "guid": fmu.guid})


class Form(NamedTuple):
    """A version of the standard: files of C beside the model's, others, and the kinds of variables."""

    sources: tuple[File[Fmu], ...]
    others: tuple[File[Fmu], ...]
    kinds: Mapping[str, str]


def _of_2(fmu: Fmu) -> dict[str, object]:
    return _description(fmu, "2.0")


def _of_3(fmu: Fmu) -> dict[str, object]:
    return _description(fmu, "3.0")


#: Versions of the standard, and the files of each.
FORMS = {
    "2.0": Form(
        (File("@{name}_fmi2.h", "fmi2.h"), File("@{name}_fmu.c", "fmu2.c")),
        (File("modelDescription.xml", "modelDescription.xml", _of_2),),
        {"Real": "Real", "Integer": "Integer"},
    ),
    "3.0": Form(
        (File("@{name}_fmi3.h", "fmi3.h"), File("@{name}_fmu.c", "fmu3.c")),
        (
            File("modelDescription.xml", "modelDescription3.xml", _of_3),
            File("sources/buildDescription.xml", "buildDescription.xml"),
        ),
        {"Real": "Float64", "Integer": "Int32"},
    ),
}


def write_fmu(path: str | os.PathLike[str], fmu: Fmu, fmi: str) -> Path:
    """Write the archive whole, of a version of the standard that `FORMS` has.

    Raises InvalidInput: for another version, a path that cannot be written, or without a C compiler.
    """
    one_of("There is no such version of FMI.", fmi, FORMS, "2.0, which most programs read")
    target, form = checked_path("The FMU", path), FORMS[fmi]
    check_replaceable(target, "FMU", lambda content: b"modelDescription.xml" in content)
    model = rendered([fmu.model], fmu, fmu.name, DOUBLE)
    contents = (fmu.name, fmu.about, fmu.period, fmu.variables, {**fmu.sources, **model})
    guid = "{" + str(uuid.UUID(hashlib.sha256(repr((contents, fmi)).encode()).hexdigest()[:32])) + "}"
    own = replace(fmu, guid=guid)
    shared = {"v": int(fmi[0]), "guid": guid, "about": fmu.about, "period": fmu.period}
    sources = {**fmu.sources, **rendered([own.model, *form.sources], own, fmu.name, DOUBLE, **shared)}
    compiled = [file for file in sources if file.endswith(".c")]
    others = rendered(form.others, own, fmu.name, DOUBLE, files=compiled, **shared)
    folder, ending = _place(fmi)
    files = {
        **{file: text.encode() for file, text in others.items()},
        **{f"sources/{file}": code.encode() for file, code in sources.items()},
        f"binaries/{folder}/{fmu.name}.{ending}": shared_library(sources),
    }
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


def _description(fmu: Fmu, fmi: str) -> dict[str, object]:
    """Variables, units and outputs of modelDescription.xml, in which a variable is known by its place (FMI 2.0) or its
    reference (3.0)."""
    variables, kinds = fmu.variables, FORMS[fmi].kinds
    references = _references(variables, fmi)
    ids = {v.name: k + 1 for k, v in enumerate(variables)} if fmi == "2.0" else references
    return {
        "units": sorted({variable.unit for variable in variables if variable.unit}),
        "variables": [_entry(variable, references[variable.name], kinds) for variable in variables],
        "outputs": [
            {
                "id": ids[v.name],
                "starts_from": None if v.starts_from is None else sorted(ids[one] for one in v.starts_from),
            }
            for v in variables
            if v.causality == "output"
        ],
    }


def _references(variables: Sequence[FmuVariable], fmi: str) -> dict[str, int]:
    """References by name: in FMI 2.0 each kind counts from zero, in 3.0 they follow each other."""
    chosen: dict[str, int] = {}
    for kind in ("Real", "Integer", "Boolean"):
        first = 0 if fmi == "2.0" else len(chosen)
        names = [variable.name for variable in variables if variable.kind == kind]
        chosen |= {name: first + k for k, name in enumerate(names)}
    return chosen


def _entry(variable: FmuVariable, reference: int, kinds: Mapping[str, str]) -> dict[str, object]:
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
