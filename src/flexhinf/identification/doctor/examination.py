"""The list of all checks of a log, and `examine`, which makes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from flexhinf.findings import above_note, ordered
from flexhinf.identification.doctor import scales, springs, times
from flexhinf.identification.doctor.beside_model import beside_model
from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.doctor.record import LogRecord
from flexhinf.identification.doctor.values import cleaned
from flexhinf.identification.log import Log
from flexhinf.robot import Robot
from flexhinf.validation import checked_kind

#: Checks of a record whose values are clean, in the order in which they are likely: what a wrong unit of the times does
#: to positions is said of the times.
CHECKS: tuple[Callable[[LogRecord], Iterator[LogFinding]], ...] = (
    times.apart,
    scales.plausible,
    scales.inputs,
    scales.ratios,
    scales.speeds,
    springs.against_links,
    times.gaps,
    times.arrival_or_drops,
)


def examine(
    log: Log, robot: Robot | None = None, model: bool = True, late: Mapping[str, int] | None = None
) -> tuple[LogFinding, ...]:
    """What a log shows of itself, before any model, and then beside its robot: the worst first.

    First what its reader noticed, then each signal's own values, the times, and the sizes of columns beside each other
    and beside the robot's limits. If all this is right, signals that are late or of the other sign, by the likelihood
    of the robot's model, whose stiffness, friction and motor inertia may be others than its file says.

    Parameters
    ----------
    log : Log
        With the names of its signals, as `read_log` makes it.
    robot : Robot, optional
        Whose log it is; without one nothing is compared with limits and vibrations.
    model : bool
        Whether the likelihood of the robot's model is looked at too, in seconds: of up to three joints, and where the
        robot moves.
    late : mapping of str to int, optional
        Samples by which signals were stated late when the log was read, for the advice.

    Raises
    ------
    InvalidInput
        For anything but a log.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> time = 0.01 * np.arange(400)
    >>> angle = np.sin(time) % (2.0 * np.pi)
    >>> log = fh.Log(time, np.cos(time), angle, names={"input": ["motor_voltage"], "output": ["link_position"]})
    >>> fh.examine(log)[0].kind
    'turns'
    """
    checked_kind("There is no log to examine.", log, Log, "a Log", 'fh.read_log("log.csv", plant)')
    if robot is not None:
        checked_kind("The robot of the log is none.", robot, Robot, "a Robot", 'fh.load_robot("arm.toml")')
    findings, record = cleaned(LogRecord.of(log, robot))
    findings = [*log.findings, *findings]
    for check in CHECKS:
        findings += check(record)
        unusable = {finding.signal for finding in findings if finding.refused}
        if unusable:  # nothing else can be said of numbers in another unit
            return ordered(each for each in findings if each.refused or each.signal not in unusable)
    if robot is not None and model and not above_note(findings):
        findings += beside_model(log, robot, late)
    return ordered(findings)
