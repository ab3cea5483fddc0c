"""``flexhinf export`` with ``flexhinf compile``: a controller as code for a machine."""

# typer's classes narrow those of click.
# pyright: reportIncompatibleMethodOverride=false

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import join, quote
from typing import Any

import typer
from typer.main import get_command

import flexhinf as fh
from flexhinf import export, report
from flexhinf.cli.arguments import (
    Command,
    Group,
    refuse_existing,
    with_options,
)
from flexhinf.cli.designs import (
    DesignedController,
    controller_file,
    controller_of,
    file_of,
)
from flexhinf.cli.messages import note, options
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import write_file
from flexhinf.validation import file_digest


class ExportGroup(Group):
    """The exports, with those that other packages add."""

    def list_commands(self, ctx: typer.Context) -> list[str]:
        """Names of all."""
        from flexhinf.designs.exports import EXPORTS

        return list(dict.fromkeys([*super().list_commands(ctx), *EXPORTS]))

    def get_command(self, ctx: typer.Context, cmd_name: str) -> Any:
        """The command of a name; None for one that is not known."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        from flexhinf.designs.exports import EXPORTS

        if cmd_name not in EXPORTS:
            return None

        def export(context: typer.Context, o: options.ExportFileOptions) -> None:
            _export(cmd_name, o)

        export.__doc__ = EXPORTS[cmd_name].help
        alone = typer.Typer(add_completion=False)
        alone.command(cmd_name, cls=Command)(with_options(lambda: (options.ExportFileOptions, ()))(export))
        return get_command(alone)


app = typer.Typer(
    cls=ExportGroup,
    help="Export the controller of a design: C source, an FMU, or a page in which the arm moves.",
)


@app.command("c", cls=Command)
@with_options(lambda: (options.ExportCOptions, ()))
def export_c(context: typer.Context, o: options.ExportCOptions) -> None:
    """Export the controller as C99 without dependencies, with a test and what firmware needs around it.

    `make test` in the folder compiles them and runs the recorded samples: the
    numbers are those of the simulation. README.md there has signals, units,
    memory and cost.
    """
    from flexhinf.designs.responses import joint_limits

    if o.feedforward:
        _export_feedforward(o)
        return
    refuse_if(
        o.path or o.smoothing or o.shaper,
        "A path, its smoothing or a shaper is stated without --feedforward.",
        f"expected none for a controller, got {o.path or o.smoothing or '--shaper'}",
        f"flexhinf export c {o.source} --feedforward, for a robot; or leave it out",
    )
    if o.name:
        export.checked_identifier(o.name)
    path = controller_file(o.source)  # the input first: a misspelt name is no matter of the output
    out = o.out or _named_after(o.source, "-c")
    folder = export.checked_folder(out, o.force)
    designed = _leaving(path, o, o.limits)
    controller, robot, s = designed.controller, designed.robot, designed.specification
    name = o.name or _identifier(robot)
    _note_doubts(designed)
    if o.narrower is not None:
        controller = export.narrowed(controller, o.narrower)
        note("Limits of inputs are narrower than those that the requirements were judged with.")
    if not o.check_measurements:
        controller = controller.fresh(measurement_limits=None, protection=None)
    elif controller.estimator is not None:  # true states are believed
        speeds = None if robot is None or s is None else joint_limits(robot, s).speed
        try:
            controller, unchecked = export.protected(controller, robot, speeds)
        except InvalidInput as unknown:
            unchecked = f"{unknown.what} To have them checked: {unknown.advice}."
        if unchecked:
            note(unchecked)
    if uncounted := export.check_room(controller, o.real, period=o.period, flash=o.flash, ram=o.ram):
        note(uncounted)
    stated = {
        "--no-check-measurements": not o.check_measurements,
        "--no-limits": not o.limits,
        "--accept-estimates": o.accept_estimates,
        "--accept-unmet": o.accept_unmet,
    }
    chosen = [option for option, there in stated.items() if there]
    chosen += [] if o.narrower is None else [f"--narrower={o.narrower:g}"]
    again = join(("flexhinf", "export", "c", o.source, "--name", name, "--real", o.real, *chosen))
    origin = _origin(path, again, designed)
    export.write_files(
        folder,
        export.controller_files(controller, name, o.real, robot, origin, _design_files(path, designed.rows)),
    )
    typer.echo(f"{name}.h, {name}.c and what goes with them: {folder}\ntest:  make -C {quote(str(out))} test")


def _export_feedforward(o: options.ExportCOptions) -> None:
    """``--feedforward``: commands along a streamed path, of a robot by name or file."""
    import numpy as np  # here, as --help needs none

    from flexhinf.export.feedforward import export_feedforward
    from flexhinf.loop import Waypoints
    from flexhinf.robot.parameters import measured
    from flexhinf.robot.parts import file_warnings
    from flexhinf.robot.waypoints import WaypointTable, waypoints

    others = {
        "--real": o.real != "double",
        "--flash": o.flash,
        "--ram": o.ram,
        "--narrower": o.narrower is not None,
        "--no-limits": not o.limits,
        "--no-check-measurements": not o.check_measurements,
    }
    refuse_if(
        any(others.values()),
        "An option of a controller has no effect on feedforward.",
        f"expected none of {list(others)}, got {[name for name, there in others.items() if there]}",
        "leave it out",
    )
    with file_warnings(note):
        robot = fh.load_robot(o.source)
    times: dict[str, float] = {}
    for name, text in (("period", o.period), ("smoothing", o.smoothing)):
        try:
            times[name] = float(measured(text, "s")) if text else 0.0
        except ValueError:
            raise InvalidInput(
                f"The {name} is no time.",
                f"expected seconds, or text with a unit, got {text!r}",
                f"--{name} 4ms",
            ) from None
    refuse_if(
        not times["period"],
        "Feedforward needs the period of the commands.",
        "expected --period, got none",
        f"--period {robot.drive_period or 4e-3:g}",
    )
    feedforward = fh.Feedforward(robot, times["period"], times["smoothing"] or 5.0 * times["period"])
    path = None
    if o.path:
        table = waypoints(o.path)
        assert isinstance(table, WaypointTable)
        spline = Waypoints(table.times, table.positions(robot.joint_names, robot.links.slides), "through")
        still = 2.0 * feedforward.delay + feedforward.period
        if o.shaper:
            still += 2.0 * float(feedforward.shaping_delay([spline(spline.duration)])[0])
        path = [spline(t) for t in np.arange(0.0, spline.duration + still, feedforward.period)]
    name = o.name or _identifier(robot)
    out = o.out or _named_after(o.source, "-feedforward")
    export_feedforward(feedforward, out, name, path, o.force, o.shaper)
    typer.echo(f"{name}.h, {name}.c and rows.csv: {out.absolute()}\ntest:  make -C {quote(str(out))} test")


@app.command("fmu", cls=Command)
@with_options(lambda: (options.ExportFmuOptions, ()))
def export_fmu(context: typer.Context, o: options.ExportFmuOptions) -> None:
    """Export the controller as an FMU for co-simulation (FMI 2.0 or 3.0), for Simulink, OpenModelica and others.

    One communication step is one sample. With --plant the FMU is the robot by
    which the design is judged, its dry friction smoothed: motor inputs and
    disturbances in, measurements and states out, its parameters to be set.
    It needs a C compiler.
    """
    from flexhinf.designs import read_request
    from flexhinf.designs.plans import true_robot
    from flexhinf.robot.parts import file_warnings

    out = o.out or _named_after(o.source, "-plant.fmu" if o.plant else ".fmu")
    if o.plant:
        refuse_if(
            not o.limits,
            "--no-limits has no effect on a plant.",
            "expected it with a controller, whose inputs have limits; got it with --plant",
            "leave out --no-limits",
        )
        path = file_of(o.source, "A plant is that of a design file.", "flexhinf export fmu DIR --plant")
        with file_warnings(note):
            request = read_request(path, is_file=True)
            robot, s = true_robot(request.robot, request.specification)  # as its design is judged
        equilibrium = robot.operating_point(s.pose if s.start is None else s.start, s.extras)
        name = o.name or export.identifier_of(robot.name)
        written = export.export_plant_fmu(
            robot.plant(s.measured, extras=s.extras), out, name, s.period, *equilibrium, fmi=o.fmi
        )
    else:
        designed = _leaving(controller_file(o.source), o, o.limits)
        _note_doubts(designed)
        name = o.name or _identifier(designed.robot)
        written = export.export_fmu(designed.controller, out, name, o.fmi, limits=False)
    typer.echo(f"FMU: {written}")


@app.command("web", cls=Command)
@with_options(lambda: (options.ExportFileOptions, ()))
def export_web(context: typer.Context, o: options.ExportFileOptions) -> None:
    """One page in which the arm runs in real time in the browser; no server, no network.

    Pull the link with the mouse, move the goal, change the arm by sliders; the
    same arm with a tuned PD moves beside it. The controller's and the plant's C
    are compiled to WebAssembly, which needs clang and wasm-ld.
    """
    _export("web", o)


def _export(name: str, o: options.ExportFileOptions) -> None:
    """Write what has a file of its own in `flexhinf.designs.exports`."""
    from flexhinf.designs.exports import EXPORTS, Exported

    kind = EXPORTS[name]
    path = (
        file_of(o.source, f"{name} needs a design, which states the robot.", f"flexhinf export {name} DIR")
        if kind.of_design
        else controller_file(o.source)
    )
    out = o.out or _named_after(o.source, kind.ending)
    refuse_existing(out, o.force)
    if kind.check is not None:
        kind.check()
    designed = controller_of(path)
    _note_doubts(designed)
    exported = Exported(designed.controller, designed.robot, designed.specification, designed.verdict.unmet)
    written = kind.write(exported, out)
    size = f" ({written.stat().st_size / 1e3:.0f} kB)" if written.is_file() else ""
    typer.echo(f"{name}: {written}{size}")


@app.command("mjcf", cls=Command)
@with_options(lambda: (options.ExportMjcfOptions, ()))
def export_mjcf(context: typer.Context, o: options.ExportMjcfOptions) -> None:
    """The elastic robot for MuJoCo: links, rotors, and a spring between each two.

    With actuators that are limited as the motors are, sensors of links and
    motors, and the pose home at rest as a keyframe. Other programs that read
    MJCF see the same two-mass joints.
    """
    from flexhinf.designs.design_file import meant_file
    from flexhinf.designs.request import read_request
    from flexhinf.robot.mjcf_export import elastic_mjcf
    from flexhinf.robot.parts import file_warnings

    with file_warnings(note):
        robot = read_request(meant_file(o.source), o.elastic or None, payload=o.payload or None).robot
    out = o.out or Path(f"{robot.name}.xml")
    refuse_existing(out, o.force)
    model = elastic_mjcf(robot)
    for name, why in model.left_out.items():
        note(f"Without {name}: MuJoCo does not express it, {why}.")
    write_file(out, "MJCF file", lambda place: Path(place).write_text(model.text, encoding="utf-8"))
    typer.echo(f"MJCF: {out}")


@with_options(lambda: (options.CompileOptions, ()))
def compile_design(context: typer.Context, o: options.CompileOptions) -> None:
    """Compile the controller to a shared library that starts in milliseconds.

    fh.load_compiled(FILE) steps it from Python, without LLVM and CasADi; every
    output is the simulation's. For this platform; needs a C compiler.
    """
    designed = _leaving(controller_file(o.source), o)
    _note_doubts(designed)
    out = o.out or _named_after(o.source, ".so")
    typer.echo(f"library: {export.compile_controller(designed.controller, out, o.processor)}")


def _leaving(path: Path, o: options.MachineOptions, limits: bool = False) -> DesignedController:
    """The controller that leaves for a machine, refused as its options say."""
    return controller_of(path, limits=limits, estimates=o.accept_estimates, unmet=o.accept_unmet)


def _named_after(source: str, ending: str) -> Path:
    """What is made of a design, in the working folder: under the name of its folder, or of its file where that has a
    name of its own."""
    place = Path(source).resolve()
    own = place.is_dir() or place.name not in ("design.toml", "controller")
    return Path((place if place.is_dir() else place.with_suffix("") if own else place.parent).name + ending)


def _note_doubts(designed: DesignedController) -> None:
    """Print what speaks against a controller that leaves for a machine."""
    from flexhinf.designs.verdict import estimated_text

    if text := designed.verdict.unmet:
        note(f"{text}.")
    if designed.robot is not None and (text := estimated_text(designed.robot)):
        note(f"{text[:1].upper()}{text[1:]}.")
    if free := export.unlimited_inputs(designed.controller):
        note(f"NOTHING LIMITS {', '.join(free)}: the controller may ask for any value.")


def _origin(path: Path, command: str, designed: DesignedController) -> dict[str, str]:
    """Lines of exported C that say which design it is: its file and SHA-256, the command that exports it again, whether
    it met its requirements, and what it says of itself."""
    from flexhinf.designs.design_file import has_controller
    from flexhinf.designs.requirements.requirement import PAST
    from flexhinf.designs.verdict import estimated_text

    digest, numbers, rows = file_digest(path), {}, designed.rows
    if has_controller(path) and report.unchanged(path.parent, ("design.json",)):
        known = json.loads((path.parent / "design.json").read_text(encoding="utf-8"))
        facts = known.get("facts", {})
        numbers = {name: f"{facts[name]:.6g}" for name in ("gamma", "degree") if facts.get(name) is not None}
        if day := report.written_on(path.parent):
            numbers = {"designed on": day, **numbers}
        for name, known_digest in report.sources(path.parent).items():
            numbers[f"file {name}"] = f"SHA-256 {known_digest}"
    nearly = sum(bool(row.get("within_tolerance")) for row in rows)
    met = (
        f"{len(rows) - nearly} of {len(rows)} met, and {nearly} more {PAST}"
        if nearly
        else f"all {len(rows)} met"
    )
    judged = {"requirements": designed.verdict.unmet or met} if rows else {}
    if designed.robot is not None and (text := estimated_text(designed.robot)):
        judged["estimated, not measured"] = text.partition(": ")[2]
    stated: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8")) if path.suffix == ".toml" else {}
    if verdict := stated.get("result", {}).get("verdict"):
        judged["what the design says"] = verdict
    return {"design": f"{path.name}, SHA-256 {digest}", "made by": command, **judged, **numbers}


def _design_files(path: Path, rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The design file, the robot file that it names, and a table of the requirements with what was found, by name; none
    for the file of a controller, although it may lie beside its design."""
    from flexhinf.designs.design_file import has_controller
    from flexhinf.robot import catalogue

    if path.suffix != ".toml" or not has_controller(path):
        return {}
    text = path.read_text(encoding="utf-8")
    named = str(tomllib.loads(text)["design"].get("robot", ""))
    robot = catalogue().get(named, path.parent / named)
    files = {robot.name: robot.read_text(encoding="utf-8")} if robot.is_file() else {}
    head = "| requirement | limit | found | met | where |\n|---|---|---|---|---|\n"
    return files | {"design.toml": text, "requirements.md": head + "".join(map(_requirement_line, rows))}


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else f"{value}"


def _requirement_line(row: Mapping[str, Any]) -> str:
    """A judged requirement as a line of a table; a file of an older version may lack a column."""
    from flexhinf.designs.requirements.requirement import PAST
    from flexhinf.designs.verdict import bound_name

    unit, met = row.get("unit", ""), PAST if row.get("within_tolerance") else "yes"
    cells = (
        f"{row.get('what', '')}",
        f"{bound_name(row)} {_short(row.get('limit', ''))} {unit}".strip(),
        f"{_short(row.get('found', ''))} {unit}".strip(),
        met if row["met"] else "no",
        f"{row.get('where', '')}",
    )
    return f"| {' | '.join(cells)} |\n"


def _identifier(robot: fh.Robot | None) -> str:
    """The name of exported code, by the robot, as far as it is known."""
    return export.identifier_of("controller" if robot is None else robot.name)
