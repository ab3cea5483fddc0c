"""``make bench-compared``: laws compared over the workspaces of robots, for docs/comparison.md.

``python -m benchmarks.compared`` compares the usual laws on each robot and keeps the numbers, as `flexhinf compare
ROBOT` writes them; some minutes a robot. ``--table`` prints the table from the numbers that are kept.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is imported
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import json  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

ROWS = Path(__file__).parent / "rows"

#: Robots, and what is measured.
ROBOTS: dict[str, tuple[str, ...]] = {
    "planar-two-link": ("link_position",), "vertical-rig": ("link_position", "motor_position"),
}  # fmt: skip

#: Requirements in the table, with the unit that they are shown in and its factor.
SHOWN = {
    "tracking error": ("mrad", 1e3), "remaining error": ("mrad", 1e3), "damping of oscillations": ("", 1.0),
}  # fmt: skip


def compared(name: str) -> dict[str, Any]:
    """The numbers of a comparison on a robot of the catalogue."""
    import flexhinf as fh
    from flexhinf.pages import comparison_files

    s = fh.Specification(measured=ROBOTS[name], workspace="limits")
    found = fh.compare(fh.load_robot(name), s, progress=lambda text: print(text, flush=True))
    return json.loads(comparison_files(found, ())["comparison.json"])


def table() -> str:
    """A row for each law of each robot, the best first: of each requirement the number that is nearest to its limit."""
    titles = ["robot", "law", "bandwidth"]
    titles += [f"{what} ({unit})" if unit else what for what, (unit, _) in SHOWN.items()]
    lines = [
        "| " + " | ".join((*titles, "requirements that it misses")) + " |",
        "|---" * (len(titles) + 1) + "|",
    ]
    for name in ROBOTS:
        numbers = json.loads((ROWS / f"{name}.json").read_text(encoding="utf-8"))
        rows = {law["name"]: law for law in numbers["laws"]}
        for law in (rows[key] for key in numbers["order"]):
            missed = list(dict.fromkeys(line["what"] for line in law["specification"] if not line["holds"]))
            cells = [name, f"`{law['name']}`", f"{law['bandwidth']:.3g} rad/s"]
            cells += [_worst(law["specification"], what, factor) for what, (_, factor) in SHOWN.items()]
            lines.append("| " + " | ".join((*cells, "; ".join(missed) or "none")) + " |")
    return "\n".join(lines)


def _worst(lines: list[dict[str, Any]], what: str, factor: float) -> str:
    """What was found of a requirement where it is nearest to its limit."""
    found = [line for line in lines if line["what"] == what]
    if any(line["found"] is None for line in found):
        return "diverges"
    upper = found[0]["limit"] == "at most"
    worst = max(found, key=lambda line: (line["found"] if upper else -line["found"]) / line["asked"])
    return f"{factor * worst['found']:.3g}"


def main(arguments: list[str] | None = None) -> int:
    """Compare the laws on the robots that are named, or print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compared", description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS), metavar="ROBOT")
    parser.add_argument("--table", action="store_true", help="print the table of the kept numbers")
    chosen = parser.parse_args(arguments)
    if chosen.table:
        print(table())
        return 0
    for name in chosen.robots:
        text = json.dumps(compared(name), indent=1, ensure_ascii=False)
        (ROWS / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
