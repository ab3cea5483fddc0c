"""The page of an identification: the numbers with their intervals, what the log does not tell, and how it fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flexhinf.identification import Excitation, Identification
from flexhinf.identification.alternatives import Alternative
from flexhinf.identification.consistency import SMALL_CORRELATION
from flexhinf.identification.doctor.beside_model import alternative_advice
from flexhinf.identification.explanations import HYSTERESIS, Explanation, believed
from flexhinf.identification.output_error import OutputError
from flexhinf.identification.unknowns import EXTRA_OF
from flexhinf.numerals import ends_text, estimate_text, number, number_text, percent
from flexhinf.pages.checks import finding_texts, log_findings
from flexhinf.pages.drawing import Blocks, Line, Panel, display_scale, draw_figure, listed, note
from flexhinf.pages.estimate import FilteredLog, innovation_section, log_section, measured_blocks
from flexhinf.pages.estimate_figures import signal_label
from flexhinf.pages.settings import robot_rows
from flexhinf.report import SERIES, Badge, Cell, Column, Fact, Page, Section, Table
from flexhinf.robot import Robot
from flexhinf.robot.elastic import TEETH, left_out


@dataclass(frozen=True, eq=False)
class IdentifiedRobot:
    """What `identify` found in a log, for the page, the files and the terminal.

    `stated`: the robot before. `found`: the identification. `filtered`: the log through the filter of what was found.
    `motion`: what is proposed where the log does not tell a number, or None. `extras`: of the model. `late`: samples by
    which signals were stated late, by name. `second`: the numbers of the simulation, None where it was not made or goes
    astray. `causes`: what explains what is left where the model does not fit.
    """

    stated: Robot
    found: Identification
    filtered: FilteredLog
    motion: Excitation | None
    extras: tuple[str, ...] = ()
    second: OutputError | None = None
    causes: tuple[Explanation, ...] = ()
    late: Mapping[str, int] = field(default_factory=dict[str, int])

    @property
    def likelier(self) -> Alternative | None:
        """The log with a signal at another time or of another sign that is likelier, where nothing explains more."""
        return believed(self.found, self.causes)

    @property
    def telling(self) -> Excitation | None:
        """The motion, if it tells any of the numbers that the log does not."""
        if self.motion is None:
            return None
        errors = self.motion.standard_errors
        return self.motion if any(np.isfinite(errors[name]) for name in self.found.hidden) else None


#: The largest disturbance that is advised, beside the one that was found.
DISTURBED = 1.2


def identified_verdict(result: IdentifiedRobot) -> list[str]:
    """What the log tells and what not, in sentences."""
    found = result.found
    clear = [signal_label(name) for name in found.names if name not in found.hidden]
    if not found.consistent:
        return [*_misfit_texts(result), *_advice(result)]
    texts = [*finding_texts(result.filtered.findings), *_undecided_texts(result)]
    if clear:
        texts.append(f"The log tells {listed(clear)}, if the other numbers of the robot are right.")
    if found.hidden:
        texts.append(f"It does not tell {listed([signal_label(name) for name in found.hidden])}.")
    texts += [f"{each.text[0].upper()}{each.text[1:]}." for each in found.unidentifiable]
    texts += _second_texts(result)
    if result.motion is not None and result.telling is None:
        texts.append("No motion tells them with these sensors: state some of them, or measure more.")
    return texts


def _undecided_texts(result: IdentifiedRobot) -> Iterator[str]:
    """That the log may be right with a signal at another time, and what numbers then are."""
    found = result.found
    if not found.undecided:
        return
    whats = dict.fromkeys((each.signal, each.kind, each.samples > 0) for each in found.undecided)
    how: dict[str, Callable[[bool], str]] = {
        "late": lambda later: f"comes {'later' if later else 'earlier'} than its row says",
        "moving": lambda _: "moves between rows",
        "sign": lambda _: "has the other sign",
    }
    texts = [f"{signal} {how[kind](later)}" for signal, kind, later in whats]
    ranges: list[str] = []
    for name, value in found.values.items():
        others = [each.values[name] for each in found.undecided]
        if name not in found.hidden:
            ends = ends_text(min(value, *others), max(value, *others), result.stated[name].unit)
            ranges.append(f"{signal_label(name)} {ends}")
    yield (
        f"The log is too short to tell whether {' or '.join(texts)}: it is as likely then. Depending on that, the most "
        f"likely numbers are {listed(ranges)}; the intervals hold all of them. A longer log, or one that moves more, "
        "tells it."
    )


def _misfit_texts(result: IdentifiedRobot) -> Iterator[str]:
    """That the model does not fit, and the numbers and limits that say so."""
    found = result.found
    yield "The model does not fit the log: numbers may be wrong by more than their intervals."
    remarks = finding_texts(result.filtered.findings)
    yield from remarks
    if remarks:
        yield "That may be the reason for all else: try a log without it first."
    other = result.likelier
    if other is not None:
        yield f"{other.text[0].upper()}{other.text[1:]}."
    elif result.causes:
        several = listed([each.text for each in result.causes])
        yield f"What is left is explained best by {several}."
    if found.absorbing:
        name, level, assumed = _largest_disturbance(found)
        unit = f"{found.plant.unit(name)}·√s".lstrip("·")
        share = 100.0 * found.disturbance
        yield (
            f"Innovations fit only with a disturbance {signal_label(name)} of {number(level, 3)} {unit}, "
            f"{number(share * level / assumed, 3)} % of the input, and at most {number(assumed, 3)} {unit}, "
            f"{number(share, 3)} %, is assumed: a larger one absorbs what the model lacks. What follows is with the "
            "assumed ones."
        )
    nis = found.consistency.nis
    if not found.consistency.size_fits:
        low, high = (number(end, 3) for end in nis.interval)
        yield f"The mean NIS is {number(nis.mean, 3)}, and {low} to {high} is consistent."
    for output in found.consistency.correlated:
        test = output.whiteness
        if test is None:
            continue
        worst = int(np.argmax(np.abs(test.correlations)))
        size = (
            f"{number(float(test.correlations[worst]), 2)} at lag {worst + 1} (at most {SMALL_CORRELATION:g})"
        )
        slow = f"slow changes have {number(test.slow, 2)} times the power of white noise (below {test.slowest:g})"
        large = abs(test.correlations[worst]) >= SMALL_CORRELATION
        yield f"Innovations of {signal_label(output.name)} are not white: {size if large else slow}."
    yield from _second_texts(result)
    if found.hidden:
        names = listed([signal_label(name) for name in found.hidden])
        yield f"What the log tells of {names} cannot be said before the model fits."


def _second_texts(result: IdentifiedRobot) -> Iterator[str]:
    """What the simulation alone tells, where it differs or comes near."""
    second = result.second
    if second is None:
        return
    near = number(100.0 * min(second.fits.values()), 3)
    if second.differing:
        several = listed(
            [f"{signal_label(name)} {number(second.values[name], 4)}" for name in second.differing]
        )
        yield (
            f"A simulation with the inputs alone, {near} % of the motion, says otherwise: {several}. One of both "
            "explains what the model lacks."
        )
    elif not result.found.hidden:
        yield f"A simulation with the inputs alone has {near} % of the motion and tells the same numbers."


def _cause_advice(result: IdentifiedRobot) -> Iterator[str]:
    """What to try for each cause."""
    robot = result.stated
    for cause in result.causes:
        joint = cause.signal.partition("_torque")[2].removeprefix("_")
        name = f"{cause.quantity}_{joint}" if joint else cause.quantity
        if cause.kind == "a delay":
            option = (
                "--latency"
                if cause.signal in result.found.plant.inputs
                else f"--sensor-delay {cause.signal}="
            )
            samples = result.late.get(cause.signal, 0) + round(cause.sizes[0])
            if samples >= 0:
                yield f"`{option}{' ' if option == '--latency' else ''}{samples}`"
        elif cause.quantity and name in robot.nominal:
            extra = EXTRA_OF[cause.quantity]
            if name not in result.found.names:
                yield f"`--parameters {','.join([*result.found.names, name])}`, with which the model has {extra}"
        elif cause.quantity in TEETH:
            yield f"`{cause.lines}` in the robot's file: the true robot then has it, and no model"
        elif cause.quantity:
            yield f"`{cause.lines}` in the robot's file, and then `--parameters …,{name}`"
        elif cause.kind == HYSTERESIS:
            yield (
                f"a tolerance of the stiffness that covers its slope, as no model has the "
                f"{number_text(cause.size, cause.unit, 3)} by which the spring's torque differs on its way back"
            )


def _largest_disturbance(found: Identification) -> tuple[str, float, float]:
    """The disturbance that is largest beside what is assumed: its name, and its level as found and as assumed."""
    name, (level, assumed) = max(found.disturbances.items(), key=lambda each: each[1][0] / each[1][1])
    return name, level, assumed


def _advice(result: IdentifiedRobot) -> list[str]:
    """What to try where the model does not fit."""
    other = result.likelier
    if other is not None:
        return [alternative_advice(other, result.found.plant, result.late, result.filtered.log.columns)]
    if causes := list(_cause_advice(result)):
        return [f"To try: {'; '.join(causes)}."]
    left = left_out(result.stated.nominal, result.extras)
    quick = [name for name in left if name != "inductance"] or left  # stiff: it takes ten times as long
    extras = (
        f"`--extras {','.join(quick)}`, which the robot states and the model leaves out; " if left else ""
    )
    more = "another `--latency`, another sensor in `--measured`, more `--parameters`"
    noise = ""
    if result.found.absorbing:
        _, level, assumed = _largest_disturbance(result.found)
        share = 100.0 * DISTURBED * result.found.disturbance * level / assumed
        noise = f"; `--disturbance {share:.2g}`, if the robot is disturbed by so much"
    return [f"To try: {extras}{more}{noise}."]


# Sections ----------------------------------------------------------------------------------------------
def identified_table(result: IdentifiedRobot) -> Table:
    """A row for each number: as stated, as found, with its interval."""
    found, rows = result.found, list[Sequence[object]]()
    for name, value in found.values.items():
        stated, ends, error = result.stated[name], found.intervals[name], found.standard_errors[name]
        row: tuple[object, ...] = ("", "", "", Cell("no", "yellow"))
        if name not in found.hidden:
            row = (
                estimate_text(value, *ends, stated.unit),
                ends_text(*ends, stated.unit),
                percent(error / abs(value), 2) if value else "",
                Cell("yes", "green") if found.consistent else Cell("model does not fit", "yellow"),
            )
        rows.append((signal_label(name), number_text(stated.value, stated.unit, 5), *row))
    return Table(
        (
            "number",
            Column("stated", right=True, brief=None),
            Column("identified", right=True),
            Column("95 % interval", right=True, brief="95 %"),
            Column("standard error", right=True, brief=None),
            "told by the log",
        ),
        rows,
        "Numbers of the robot as its file states them, and as the log tells them",
        "table-numbers",
        stacks=True,
        title="Numbers of the robot",
    )


def _noise_table(result: IdentifiedRobot) -> Table:
    """Levels of the noises that were found beside."""
    found = result.found

    def level(name: str) -> str:
        scale, unit = display_scale(found.noise_units[name], result.filtered.degrees)
        return number_text(scale * found.noise[name], unit, 3)

    return Table.of(
        (
            Column("signal", of=signal_label),
            Column("noise", of=lambda name: "measurement" if name in found.plant.outputs else "disturbance"),
            Column("level", right=True, of=level),
        ),
        [*found.noise],
        "Standard deviations of what is measured, and levels of white disturbances that the model leaves out",
        "table-noise",
    )


def _numbers_section(result: IdentifiedRobot) -> Section:
    """The numbers, what else the log tells of them, and in the JSON every one of these."""
    found, second, tables = result.found, result.second, [identified_table(result), _noise_table(result)]
    return Section(
        "What the log tells",
        (*tables, _correlation_table(found), _second_table(result), _cause_table(result.causes)),
        "numbers",
        True,
        numbers={
            "numbers": {
                name: {
                    "stated": result.stated[name].value, "value": value, "standard_error": found.standard_errors[name],
                    "interval": list(found.intervals[name]), "unit": result.stated[name].unit,
                    "identifiable": name not in found.hidden,
                }
                for name, value in found.values.items()
            },
            "correlations": found.correlations,
            "unidentifiable": [
                {"direction": each.direction, "standard_error": each.standard_error} for each in found.unidentifiable
            ],
            "noise": found.noise,
            "noise_units": found.noise_units,
            "simulation": second and {
                **{name: getattr(second, name) for name in ("values", "standard_errors", "errors", "fits")},
                "differing": list(second.differing),
            },
            "causes": [
                {
                    **{name: getattr(each, name) for name in ("kind", "signal", "size", "unit", "gain", "share")},
                    "standard_error": max(each.errors),
                }
                for each in result.causes
            ],
        },
    )  # fmt: skip


def _correlation_table(found: Identification) -> Table | None:
    """Correlations of the errors of the numbers that the log tells, where there are several."""
    clear = [k for k, name in enumerate(found.names) if name not in found.hidden]
    names = [signal_label(found.names[k]) for k in clear]
    rows = [
        (name, *("" if not np.isfinite(value) else number(float(value), 2) for value in row))
        for name, row in zip(names, found.correlations[np.ix_(clear, clear)])
    ]
    says = "Correlations of the errors: near 1 or −1, the log tells only what two numbers have together"
    columns = ("", *(Column(name, right=True) for name in names))
    return Table(columns, rows, says, "table-correlations") if len(clear) > 1 else None


def _second_table(result: IdentifiedRobot) -> Table | None:
    """Numbers of the simulation beside those of the likelihood."""
    found, second = result.found, result.second
    if second is None:
        return None

    def text(name: str, value: float) -> str:
        return estimate_text(value, *found.intervals[name], result.stated[name].unit)

    def error(name: str) -> str | None:
        size = second.standard_errors[name]
        return number_text(size, result.stated[name].unit, 2) if np.isfinite(size) else None

    def same(name: str) -> str | Cell:
        if name in found.hidden:
            return "not told"
        return Cell("no", "yellow") if name in second.differing else Cell("yes", "green")

    near = [f"{percent(fit, 4)} of the motion of {signal_label(name)}" for name, fit in second.fits.items()]
    return Table.of(
        (
            Column("number", of=signal_label),
            Column("by the likelihood", right=True, of=lambda name: text(name, found.values[name])),
            Column("by the simulation", right=True, of=lambda name: text(name, second.values[name])),
            Column("standard error", right=True, of=error),
            Column("the same", of=same),
        ),
        [*second.values],
        "A second opinion: the numbers with which a simulation with the log's inputs comes nearest (output error). It "
        f"explains {listed(near)}",
        "table-second",
        stacks=True,
    )


def _cause_table(causes: Sequence[Explanation]) -> Table | None:
    """What explains what is left, the most first."""
    columns = (
        Column("cause", of=lambda cause: f"{cause.kind} {cause.place}"),
        Column("size", right=True, of=lambda cause: number_text(cause.size, cause.unit, 3)),
        Column("standard error", right=True, of=lambda cause: number_text(max(cause.errors), cause.unit, 2)),
        Column("share of what is left", right=True, of=lambda cause: percent(cause.share)),
        Column("log-likelihood +", right=True, of=lambda cause: number(cause.gain, 3)),
    )
    says = "What explains the innovations that are left, each beside those above it"
    return Table.of(columns, causes, says, "table-causes", stacks=True) if causes else None


def _motion_blocks(result: IdentifiedRobot, motion: Excitation) -> Blocks:
    errors = motion.standard_errors
    clear = [f"{signal_label(name)} to ± {percent(e, 2)}" for name, e in errors.items() if np.isfinite(e)]
    texts = [f"Driven on the robot, motion.csv would tell {', '.join(clear)}."] if clear else []
    texts += [
        f"No motion tells this: {each.text}. State one of these numbers." for each in motion.unidentifiable
    ]
    yield note(" ".join(texts))
    units = [display_scale(unit, result.filtered.degrees) for unit in result.stated.links.position_units]
    panels = [
        Panel(
            f"position of {name}",
            unit,
            [Line(motion.times, scale * column, "", {"color": SERIES[0], "linewidth": 1.3})],
        )
        for name, (scale, unit), column in zip(result.stated.joint_names, units, motion.positions.T)
    ]
    says = "Link positions of the proposed motion, within limits."
    yield lambda: draw_figure("motion", panels[:4], says, "Proposed motion")


def identified_page(result: IdentifiedRobot, command: Sequence[str], warnings: Sequence[str]) -> Page:
    """The report; `command` makes it again, `warnings` are of the robot's file."""
    found, filtered, stated, log = result.found, result.filtered, result.stated, result.filtered.log
    count, unclear, other = len(found.names), len(found.hidden), result.likelier
    many = f"{count - unclear} of {count} numbers" if unclear else "all numbers"
    said = identified_verdict(result)
    status = [
        None if found.consistent else Badge("risky", "The model does not fit the log."),
        Badge("risky", "The log does not tell when its signals were true.") if found.undecided else None,
        Badge("risky" if unclear else "met", f"The log tells {many}.")
        if unclear or found.consistent
        else None,
    ]
    times = ("signal", "kind", "samples", "gain")
    motion = result.motion and {
        "duration_s": result.motion.reference.duration, "standard_errors": result.motion.standard_errors,
    }  # fmt: skip
    return Page(
        f"What the log {log.source} tells of “{stated.name}”",
        f"Numbers of the robot “{stated.name}” by maximum likelihood, from {len(log)} samples in "
        f"{number_text(float(log.times[-1] - log.times[0]), 's')}.",
        said[0],
        (
            _numbers_section(result),
            Section(
                "A motion that would tell more",
                () if result.telling is None else [*_motion_blocks(result, result.telling)],
                "motion",
                True,
                numbers={"motion": motion},
            ),
            innovation_section(filtered, "Does the model fit the log?"),
            Section("Measured and predicted", [*measured_blocks(filtered)], "signals"),
            replace(log_findings(filtered.findings), open=bool(finding_texts(filtered.findings))),
            log_section(filtered, warnings),
        ),
        command,
        settings={"Robot": robot_rows(stated)},
        facts=[_fact(result, name) for name in [*found.values][:4]],
        status=[*filter(None, status)],
        details=said[1:],
        lead=("measured", "innovations"),
        head={
            "robot": stated.name, "log": log.source, "samples": found.samples,
            "log_likelihood": found.log_likelihood, "says": said, "model_fits": found.consistent,
            "disturbances": {
                name: {"found": level, "assumed": assumed} for name, (level, assumed) in found.disturbances.items()
            },
            "likelier": other and {name: getattr(other, name) for name in times},
            "undecided": [
                {**{name: getattr(each, name) for name in times}, "values": {**each.values}}
                for each in found.undecided
            ],
        },
    )  # fmt: skip


def _fact(result: IdentifiedRobot, name: str) -> Fact:
    """A number that was looked for, as told or as stated."""
    stated, ends = result.stated[name], result.found.intervals[name]
    if name in result.found.hidden:
        return Fact(
            signal_label(name), number(stated.value, 4), stated.unit, "as stated; not told by the log"
        )
    value = estimate_text(result.found.values[name], *ends)
    return Fact(signal_label(name), value, stated.unit, f"95 %: {ends_text(*ends, stated.unit)}")
