"""Commands on logs: ``flexhinf estimate``, whether a filter fits one; ``flexhinf identify``, what one tells."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

import flexhinf as fh
from flexhinf import pages, report
from flexhinf.cli.arguments import read_source, reproduce_command, stated_fields, with_options
from flexhinf.cli.messages import options, show, step_progress
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.options import interval
from flexhinf.validation import extra_package, one_of, value_text

if TYPE_CHECKING:  # what computes is loaded by the command that needs it
    from flexhinf.designs import DesignRequest
    from flexhinf.estimation.bounds import Bounds


def _column_options(found: re.Match[str]) -> str:
    """Several entries of a dictionary of columns, as options."""
    entries = re.findall(r"'([^']*)': '([^']*)'", found[1])
    return " ".join(f'--column "{signal}={column}"' for signal, column in entries)


#: How what an error of `flexhinf.read_log` advises is written at the command line.
_SYNTAX = (
    (r"columns=\{('[^']*': '[^']*'(?:, '[^']*': '[^']*')+)\}", _column_options),
    (r"columns=\{'([^']*)': '?([^'}]*)'?\}", r'--column "\1=\2"'),
    (r"units=\{'([^']*)': '([^']*)'\}", r'--column "SIGNAL=\1 [\2]"'),
    (r"delays=\{'([^']*)': (\d+)\}", r"--sensor-delay \1=\2"),
    (r"hold_inputs=True", "--hold-inputs"),
    (r"unwrap=\('(\w+)',\)", r"--unwrap \1"),
    (r"\btime=('[^']*')", r"--time \1"),
    (r"robot\.plant\(measured=\.\.\.\)", "--measured"),
)


@with_options(lambda: (options.EstimateOptions, options.ESTIMATE_FIELDS))
def estimate(context: typer.Context, o: options.EstimateOptions) -> None:
    """Estimate the states of a robot from a log, and judge whether filter and log fit.

    Columns with the names of the robot's signals are found by themselves:
    drive_torque (or motor_voltage, motor_current), motor_position and so on. With
    several joints the name of the joint follows: motor_position_elbow. --column
    names others. A unit stands behind the name: pos (deg).

    The noise levels come from the log, unless options state them or --robot is a
    design. The page says whether innovations are white, and as large as the filter
    expects. estimate.csv has the estimates, estimate.json the numbers.

    Exit code: 0 when the report is written; 2 for a mistake (nothing is written);
    130 if interrupted.
    """
    fields, columns = stated_fields(context), stated_columns(o.column)
    request = read_source(stated_robot(o), o.elastic, fields, o.payload)
    if o.table == "parquet":
        extra_package("pyarrow", "log", "Estimates in Parquet need another package.")
    folder = report.check(o.out)
    plant = request.robot.plant(request.specification.measured, extras=request.specification.extras)
    bounds = _bounds(o.bounds, plant)
    with step_progress(3) as progress:
        progress(f"read {o.log.name}")
        known = request.specification.known_latency if request.file is not None else 0
        latency = known if o.latency is None else o.latency
        log = _usable(o, request.robot, plant, columns, latency)
        progress("filter")
        filter, sources = _filter(o, request, plant, log, fields, bounds)
        data = fh.filter_log(filter, log, o.smooth)
        judged = fh.consistency(data)
        late = stated_late(o, plant, latency)
        findings = fh.examine(log, request.robot, not judged.innovations_fit, late)
        result = pages.FilteredLog(
            request.robot, log, filter, data, judged, sources, findings, in_degrees(request)
        )
        progress("report")
        notes = pages.left_out_notes(request.robot, request.specification.extras, "the model")
        page = pages.estimate_page(result, reproduce_command(context), [*request.warnings, *notes])
        others = {f"estimate.{o.table}": pages.estimate_file(result, o.table)}
        files = pages.report_files(page, "estimate.json", others)
    _concluded(page, notes, folder, files)


def in_degrees(request: DesignRequest) -> bool:
    """Whether the robot is that of a design whose pages show angles in degrees: those of its logs do too."""
    return request.file is not None and request.specification.in_degrees


def stated_robot(o: options.LogOptions) -> str:
    """The robot that options state, which a log needs."""
    refuse_if(
        not o.robot,
        "The robot of the log is not stated.",
        "expected --robot, got none",
        "--robot arm.toml, or a name that `flexhinf robots` lists",
    )
    return o.robot


@with_options(lambda: (options.IdentifyOptions, options.IDENTIFY_FIELDS))
def identify(context: typer.Context, o: options.IdentifyOptions) -> None:
    """Identify a robot's stiffness, friction and other numbers from a log.

    The result is the numbers under which the log is most likely, with 95 %
    intervals. robot.toml is the robot's file with these numbers and their
    intervals as tolerances; `flexhinf design` takes it. A number that the log does
    not determine stays as it was. motion.csv then is a motion within the limits
    that would determine it, if there is one. Where the model does not fit the log,
    numbers may be wrong by more than their intervals; what explains the rest is
    named. A simulation with the log's inputs is fitted too, as a second opinion.

    Without --parameters they are those that have a tolerance in the robot's file.

    Exit code: 0 when the report is written; 1 if the log does not determine some
    number, or the model does not fit the log; 2 for a mistake (nothing is
    written); 130 if interrupted.
    """
    from flexhinf.identification.explanations import explanations
    from flexhinf.identification.unknowns import extras_of, model_of, uncertain_numbers
    from flexhinf.robot.saved_file import robot_text

    fields, columns = stated_fields(context), stated_columns(o.column)
    request = read_source(stated_robot(o), o.elastic, fields, o.payload)
    robot, s = request.robot, request.specification
    stated = [name for name in map(str.strip, o.parameters.split(",")) if name]
    names = stated or list(uncertain_numbers(robot))
    refuse_if(
        not names,
        "No number is to be identified.",
        "expected --parameters, or a robot whose numbers have tolerances, got neither",
        "--parameters stiffness,friction,motor_inertia",
    )
    folder = report.check(o.out)
    plant, numbers = model_of(robot, names, s.measured, s.extras)
    extras = extras_of(robot, numbers, s.extras)
    robot_text(robot, folder)  # refuses a robot that has no file, before any work
    with step_progress(4) as progress:
        progress(f"read {o.log.name}")
        known_latency = s.known_latency if request.file is not None else 0
        latency = known_latency if o.latency is None else o.latency
        log = _usable(o, robot, plant, columns, latency)
        progress("identify")
        process, sensors = _stated_noises(request, plant, fields)
        found = fh.identify(
            robot,
            log,
            names,
            measured=plant.outputs,
            extras=s.extras,
            sensors=sensors,
            process_noise=process,
            disturbance=0.01 * o.disturbance,
        )
        filter = found.filter(log.period, as_expected=True)
        data = fh.filter_log(filter, log)
        sources = {"period": "the log"} | {
            name: "option" if is_stated else "the log"
            for name, is_stated in (
                ("process noise", process is not None),
                ("measurement noise", "measurement_noise" in fields),
            )
        }
        findings = fh.examine(log, robot, model=False)
        filtered = pages.FilteredLog(
            found.robot, log, filter, data, found.consistency, sources, findings, in_degrees(request)
        )
        progress("motion")
        motion = None
        if found.unidentifiable:
            known = {*plant.outputs, *plant.disturbances}  # and not R^v, where that is stated
            motion = fh.excitation(
                robot,
                names,
                duration=o.motion,
                period=min(log.period, 0.01),
                measured=plant.outputs,
                extras=s.extras,
                noise={name: level for name, level in found.noise.items() if name in known},
                seed=o.seed,
            )
        second = fh.output_error(found, log) if o.simulate else None
        causes = () if found.consistent else explanations(found, log)
        late = stated_late(o, plant, latency)
        result = pages.IdentifiedRobot(robot, found, filtered, motion, extras, second, causes, late)
        progress("report")
        text = robot_text(found.robot, folder)
        notes = pages.left_out_notes(robot, extras, "the model")
        page = pages.identified_page(result, reproduce_command(context), [*request.warnings, *notes])
        others = {"robot.toml": text} | (
            {} if result.telling is None else {"motion.csv": result.telling.table()}
        )
        files = pages.report_files(page, "identify.json", others)
    _concluded(page, notes, folder, files)
    if motion is not None or not found.consistent:
        raise typer.Exit(1)


def _concluded(
    page: report.Page, notes: Sequence[str], folder: Path, files: Mapping[str, str | bytes]
) -> None:
    """Write a report, and say what it says, with notes."""
    report.write(folder, files)
    ending = pages.page_ending(page, notes)
    show(ending.tables)
    typer.echo(f"{ending.text}\nreport: {folder / 'index.html'}")


def read_stated(o: options.LogOptions, plant: fh.Plant, columns: dict[str, str], latency: int) -> fh.Log:
    """The log as options state its columns; a refusal is in the syntax of the command line."""
    try:
        return fh.read_log(
            o.log,
            plant,
            columns,
            o.time or None,
            None,
            o.hold_inputs,
            latency,
            _delays(o.sensor_delay),
            o.missing,
            o.unwrap,
            o.repeated,
        )
    except InvalidInput as error:
        texts = [error.what, error.found, error.advice]
        for pattern, option in _SYNTAX:
            texts = [re.sub(pattern, option, text) for text in texts]
        raise InvalidInput(*texts) from None


def _usable(
    o: options.LogOptions, robot: fh.Robot, plant: fh.Plant, columns: dict[str, str], latency: int
) -> fh.Log:
    """The log, if its times and positions can be in the units that they are taken in."""
    from flexhinf.identification.doctor import refuse_unusable

    log = read_stated(o, plant, columns, latency)
    refuse_unusable(fh.examine(log, robot, model=False))
    return log


def _stated_noises(
    request: DesignRequest, plant: fh.Plant, fields: Mapping[str, Any]
) -> tuple[Any, tuple[fh.Sensor, ...]]:
    """R^v (n, n) per row, None if no option states it, and the sensors whose noise or step an option states."""
    import numpy as np  # here, as --help needs none

    from flexhinf.designs.loop_setup import LoopPlants
    from flexhinf.designs.noise_levels import EstimatorNoise, sensor_steps

    s, robot = request.specification, request.robot
    process = None
    if {"process_noise", "torque_noise"} & {*fields}:
        process = EstimatorNoise.stated(s).covariance(plant.states)
    noise, steps = np.zeros(len(plant.outputs)), np.zeros(len(plant.outputs))
    if "measurement_noise" in fields:
        noise = np.sqrt(LoopPlants(robot, s).noise_variances)
    if "quantisation" in fields:
        steps = np.broadcast_to(sensor_steps(robot, s.measured, s.quantisation, s.estimator), len(steps))
    return process, tuple(
        fh.Sensor(name, noise=float(deviation), quantisation=float(step))
        for name, deviation, step in zip(plant.outputs, noise, steps)
    )


def _filter(
    o: options.EstimateOptions,
    request: DesignRequest,
    plant: fh.Plant,
    log: fh.Log,
    fields: Mapping[str, Any],
    bounds: Bounds,
) -> tuple[fh.UnscentedKalmanFilter | fh.ExtendedKalmanFilter, dict[str, str]]:
    """The filter, and who states its period and its noises: options, the design, or the log itself."""
    from flexhinf.designs.loop_setup import LoopPlants  # not for `flexhinf --help`
    from flexhinf.designs.noise_levels import EstimatorNoise
    from flexhinf.identification.defaults import default_filter

    kinds = {"unscented": fh.UnscentedKalmanFilter, "extended": fh.ExtendedKalmanFilter}
    s, designed = request.specification, request.file is not None
    torques = {"process_noise", "torque_noise"} & {*fields}
    sources = {
        name: "option" if stated else "the design" if designed else "the log"
        for name, stated in (
            ("period", "period" in fields),
            ("process noise", torques),
            ("measurement noise", "measurement_noise" in fields),
        )
    }
    process = EstimatorNoise.stated(s).covariance(plant.states) if designed or torques else None
    from_log = sources["measurement noise"] == "the log"
    return default_filter(
        plant,
        log.times,
        log.inputs,
        log.outputs,
        kinds[o.filter],
        o.form,
        None if sources["period"] == "the log" else s.period,
        process,
        None if from_log else LoopPlants(request.robot, s).noise_variances,
        gate=o.gate,
        bounds=bounds,
    ), sources


def _bounds(stated: Sequence[str], plant: fh.Plant) -> Bounds:
    """Intervals by state, of ``state=low..high``; a group's name stands for the states of all joints."""
    bounds: Bounds = {}
    for text in stated:
        name, equals, ends = (part.strip() for part in text.partition("="))
        names = plant.expanded(name) if equals else ()
        within = None
        with suppress(ValueError):
            within = interval(ends)
        if not names or within is None or not within[0] < within[1] or set(names) & set(bounds):
            raise InvalidInput(
                f"--bounds {'names ' + repr(name) + ' twice' if set(names) & set(bounds) else 'cannot be used'}.",
                f"expected state=low..high with low < high, each state once, got {value_text(text, 60)}",
                "--bounds link_position=-90deg..90deg",
            )
        for one in names:
            one_of(f"--bounds: there is no state {value_text(one, 60)}.", one, plant.states)
            bounds[one] = within
    return bounds


def _delays(stated: Sequence[str]) -> dict[str, int]:
    """Samples by signal, of ``signal=samples``."""
    delays: dict[str, int] = {}
    for text in stated:
        name, _, samples = (part.strip() for part in text.partition("="))
        refuse_if(
            not (name and samples.isascii() and samples.isdigit()) or name in delays,
            f"--sensor-delay {'names ' + repr(name) + ' twice' if name in delays else 'cannot be used'}.",
            f"expected signal=samples, each signal once, got {value_text(text, 60)}",
            "--sensor-delay motor_position=1",
        )
        delays[name] = int(samples[:9])
    return delays


def stated_late(o: options.LogOptions, plant: fh.Plant, latency: int) -> dict[str, int]:
    """Samples by which signals are stated late, by name: inputs by the latency."""
    delays = _delays(o.sensor_delay)
    return dict.fromkeys(plant.inputs, latency) | {
        one: samples for name, samples in delays.items() for one in plant.expanded(name) or (name,)
    }


def stated_columns(stated: Sequence[str]) -> dict[str, str]:
    """Columns by signal, of ``signal=column``."""
    columns: dict[str, str] = {}
    for text in stated:
        name, equals, column = (part.strip() for part in text.partition("="))
        refuse_if(
            not (name and equals and column) or name in columns,
            f"--column {'names ' + repr(name) + ' twice' if name in columns else 'cannot be used'}.",
            f"expected signal=column, each signal once, got {text!r}",
            '--column "motor_position=pos [deg]"',
        )
        columns[name] = column
    return columns
