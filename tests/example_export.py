"""An export in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

from pathlib import Path

from flexhinf.codegen.c import Real
from flexhinf.designs.exports import ExportKind, register
from flexhinf.export.file_list import File, rendered


def write(exported, path):
    """What a fieldbus needs to know: the sampling period and the names of all signals, as JSON."""
    template = Path(__file__).with_name("example_export.txt")
    files = [File("signals.json", template, lambda controller: {"c": controller})]
    (text,) = rendered(files, exported.controller, "signals", Real("double")).values()
    path.write_text(text, encoding="utf-8")
    return path


register(
    ExportKind("signals", "Period and signals as JSON, for a fieldbus.", ".json", write, of_design=False)
)
