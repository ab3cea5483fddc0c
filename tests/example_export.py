"""An export in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

import json

from flexhinf.design.exports import ExportKind, register


def write(exported, path):
    """What a fieldbus needs to know: the sampling period and the names of all signals, as JSON."""
    own = exported.controller
    signals = {"measured": list(own.measured), "inputs": list(own.law.input_names)}
    path.write_text(json.dumps({"period_s": own.period, **signals}), encoding="utf-8")
    return path


register(
    ExportKind("signals", "Period and signals as JSON, for a fieldbus.", ".json", write, of_design=False)
)
