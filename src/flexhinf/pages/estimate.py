"""The page of a filtered log: how its innovations fit the filter, measured signals, estimates with their bands."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.identification.consistency import SMALL_CORRELATION, OutputConsistency, SquaredError
from flexhinf.numerals import number, number_text, percent
from flexhinf.pages.checks import finding_texts, log_findings
from flexhinf.pages.drawing import listed, note
from flexhinf.pages.estimate_figures import (
    BAND,
    FilteredLog,
    estimate_blocks,
    innovation_blocks,
    measured_blocks,
    signal_label,
)
from flexhinf.pages.settings import robot_rows
from flexhinf.report import Badge, Cell, Column, Fact, Page, Section, Table
from flexhinf.validation import extra_package

if TYPE_CHECKING:
    import xarray as xr


#: Mean of innovations, in parts of their size, that is named.
BIAS = 0.2


# What the innovations say -----------------------------------------------------------------------------
def judgement(result: FilteredLog) -> tuple[bool, list[str]]:
    """Whether the filter fits the log, and what the log and the innovations say, in sentences, the main ones first."""
    judged = result.judged
    nis, texts = judged.nis, finding_texts(result.findings)
    low, high = (number(end, 3) for end in nis.interval)
    mean = f"(mean NIS {number(nis.mean, 3)} of 1, consistent from {low} to {high})"
    correlated = judged.correlated
    if nis.judgement == "as expected":
        texts.append(f"Innovations are as large as the filter expects {mean}.")
    elif judged.size_fits:
        coarse = listed([signal_label(output.name) for output in judged.outputs if output.coarse])
        texts.append(
            f"Innovations are smaller than the filter expects {mean}, as the steps of {coarse} make them."
        )
    elif nis.factor == 0.0:
        texts.append(f"Innovations are zero {mean}: nothing in the log moves.")
    else:
        factor = nis.factor if nis.judgement == "larger" else 1.0 / nis.factor
        texts.append(
            f"Innovations are {number(factor, 3)} times {nis.judgement} than the filter expects {mean}."
        )
        if not correlated:
            small, scale = "too small" if nis.judgement == "larger" else "too large", number(factor**2, 2)
            texts.append(f"They are white, so Rⁿ and Rᵛ are both {small}, by a factor of about {scale}.")
    texts += _correlation_texts(correlated)
    if not correlated and judged.size_fits:
        steps = " but for the steps of the sensors" if judged.rounded else ""
        texts.append(f"They are white{steps}: the filter takes all that the log says.")
    if judged.nees is not None:
        texts.append(_nees_text(judged.nees))
    biased = [output for output in judged.outputs if abs(output.bias) > BIAS * max(1.0, output.factor)]
    if biased:
        means = listed([f"{number(output.bias, 2)} ({signal_label(output.name)})" for output in biased])
        texts.append(
            f"Innovations have a mean that is not 0, in standard deviations: {means}. An offset of the sensor or of "
            "the input, or a constant torque that the model leaves out, does so."
        )
    outliers = rejected(result)
    texts += [
        f"The gate left out {count} of {count + output.samples} measurements of {signal_label(output.name)}."
        for output in judged.outputs
        if (count := outliers.get(output.name, 0))
    ]
    nees = judged.nees is None or judged.nees.judgement != "larger"
    return judged.innovations_fit and nees, texts


def rejected(result: FilteredLog) -> dict[str, int]:
    """How many measurements of each signal the gate took for missing ones; nothing of a filter without one."""
    if "rejected" not in result.data:
        return {}
    counts = result.data["rejected"].sum("time")
    return dict(zip(counts["output_name"].values.tolist(), counts.values.tolist(), strict=True))


def _correlation_texts(correlated: Sequence[OutputConsistency]) -> Iterator[str]:
    """A sentence for the outputs whose innovations follow each other, alternate, or are related over more samples."""
    first = {output: _neighbours(output) for output in correlated}
    bounds = {output: output.whiteness.bound for output in correlated if output.whiteness}
    for outputs, how, cause in (
        (
            [output for output in first if first[output] > bounds[output]],
            "follow each other",
            "the model or the latency is wrong, or Rᵛ is too small beside Rⁿ",
        ),
        (
            [output for output in first if first[output] < -bounds[output]],
            "alternate",
            "Rᵛ is too large beside Rⁿ, so that the filter follows the noise",
        ),
    ):
        if outputs:
            names = listed([signal_label(output.name) for output in outputs])
            size = number(max((first[output] for output in outputs), key=abs), 2)
            yield f"Those of {names} {how} (correlation of neighbours {size}): {cause}."
    others = [output for output in first if abs(first[output]) <= bounds[output]]
    if others:
        names = listed([signal_label(output.name) for output in others])
        yield (
            f"Those of {names} are related over several samples: the log has a motion or a disturbance that repeats "
            "itself, and that the model does not have."
        )


def _neighbours(output: OutputConsistency) -> float:
    """The correlation of neighbours, 0 where only many small ones together are of consequence."""
    test = output.whiteness
    large = test is not None and np.abs(test.correlations).max() >= SMALL_CORRELATION
    return float(test.correlations[0]) if test is not None and large else 0.0


def _nees_text(nees: SquaredError) -> str:
    relation = {
        "as expected": "as large as the filter says",
        "larger": f"{number(nees.factor, 3)} times larger than the filter says",
        "smaller": f"{number(1.0 / nees.factor, 3)} times smaller than the filter says",
    }
    return f"Beside the true state, errors are {relation[nees.judgement]} (mean NEES {number(nees.mean, 3)} of 1)."


# Sections ----------------------------------------------------------------------------------------------
def _innovation_table(result: FilteredLog) -> Table:
    """A row for each measured signal: how large its innovations are, and how related."""

    def ratio(output: OutputConsistency) -> Cell:
        fits = 1.0 / 1.1 < output.factor < 1.1
        return Cell(number(output.factor, 3), "green" if fits else "yellow")

    def neighbours(output: OutputConsistency) -> str | None:
        return output.whiteness and number(output.whiteness.correlations[0], 2)

    def white(output: OutputConsistency) -> str | Cell:
        test = output.whiteness
        return "too few" if test is None else Cell("yes", "green") if test.white else Cell("no", "yellow")

    return Table.of(
        (
            Column("measured", of=lambda output: signal_label(output.name)),
            Column("samples", brief=None, of=lambda output: output.samples),
            Column(
                "innovation, rms",
                right=True,
                brief="rms",
                of=lambda output: result.units.text(output.name, output.rms),
            ),
            Column("expected", right=True, of=lambda output: result.units.text(output.name, output.expected)),
            Column("ratio", right=True, of=ratio),
            Column(f"in the {BAND}", right=True, brief="in 95 %", of=lambda output: percent(output.inside)),
            Column("correlation of neighbours", right=True, brief="lag 1", of=neighbours),
            Column("white", of=white),
        ),
        result.judged.outputs,
        "Innovations, measured minus predicted, beside what the filter expects of them. White: no correlation over the "
        "first lags (Ljung and Box) that is certain and above 0.1, and slow changes with less than twice the power "
        "of white noise; what the steps of a sensor explain is taken off",
        "table-innovations",
        title="Innovations: measured minus predicted",
    )


def _error_numbers(error: SquaredError | None) -> dict[str, object] | None:
    return error and {
        name: getattr(error, name) for name in ("mean", "interval", "factor", "samples", "judgement")
    }


def innovation_section(result: FilteredLog, title: str, is_open: bool = False) -> Section:
    """The innovations: a table, their figures, and in the JSON what decides whether they fit."""
    names = ("unit", "samples", "rms", "expected", "factor", "bias", "inside", "step")
    outputs = {
        output.name: {
            **{name: getattr(output, name) for name in names},
            "rejected": rejected(result).get(output.name, 0),
            "whiteness": output.whiteness
            and {
                name: getattr(output.whiteness, name)
                for name in ("white", "p_value", "correlations", "rounding")
            },
        }
        for output in result.judged.outputs
    }
    errors = {name: _error_numbers(getattr(result.judged, name)) for name in ("nis", "nees")}
    blocks = (_innovation_table(result), *innovation_blocks(result))
    return Section(title, blocks, "innovations", is_open, numbers={**errors, "outputs": outputs})


def log_section(result: FilteredLog, warnings: Sequence[str]) -> Section:
    """What is in the log, below warnings about its robot."""
    log, plant = result.log, result.filter.plant
    steps = 1e3 * np.diff(log.times)
    usual, shortest, longest = (number(float(find(steps))) for find in (np.median, np.min, np.max))

    def row(kind: str, name: str, column: np.ndarray) -> tuple[str, str]:
        (scale, unit), known = result.units.of(name), column[np.isfinite(column)]
        ends = (
            f"{number(scale * float(known.min()), 3)} to {number_text(scale * float(known.max()), unit, 3)}"
        )
        part = "" if len(known) == len(log) else f", in {len(known)} of {len(log)} samples"
        return f"{kind}: {signal_label(name)}", f"{ends}{part}"

    rows = [
        ("samples", str(len(log))),
        ("duration", number_text(float(log.times[-1] - log.times[0]), "s")),
        ("time between samples", f"{usual} ms, from {shortest} to {longest} ms"),
        *(row("input", *pair) for pair in zip(plant.inputs, log.inputs.T)),
        *(row("measured", *pair) for pair in zip(plant.outputs, log.outputs.T)),
    ]
    table = Table(("", "in the log"), rows, f"The log {log.source}", "table-log", stacks=True)
    return Section("The log", (*map(note, warnings), table), "log")


# The page and the files ----------------------------------------------------------------------------------
def estimate_page(result: FilteredLog, command: Sequence[str], warnings: Sequence[str] = ()) -> Page:
    """The report of a filtered log; `command` makes it again, `warnings` are of the robot's file."""
    fits, texts = judgement(result)
    log, robot, filter = result.log, result.robot, result.filter
    last, seconds = result.data.isel(time=-1), float(log.times[-1] - log.times[0])
    states = "fits the log" if fits else "does not fit the log"
    estimates = zip(
        filter.plant.states, last["estimate"].values, last["standard_deviation"].values, strict=True
    )
    final = {
        name: {"value": float(value), "standard_deviation": float(deviation), "unit": filter.plant.unit(name)}
        for name, value, deviation in estimates
    }
    return Page(
        f"The log {log.source} and a filter for “{robot.name}”",
        f"A log of {len(log)} samples in {number_text(seconds, 's')}, through the {result.name} of the robot "
        f"“{robot.name}”. Measured: {listed([signal_label(name) for name in filter.plant.outputs])}.",
        f"The filter {states}. {texts[0]}",
        (
            innovation_section(result, "Do the innovations fit the filter?", True),
            Section("Measured and predicted", [*measured_blocks(result)], "signals"),
            Section(
                "Estimated states", [*estimate_blocks(result)], "states", numbers={"last_estimate": final}
            ),
            replace(log_findings(result.findings), open=bool(finding_texts(result.findings))),
            log_section(result, warnings),
        ),
        command,
        settings={"Filter": _filter_rows(result), "Robot": robot_rows(robot)},
        facts=_facts(result),
        status=[Badge("met" if fits else "risky", f"The filter {states}.")],
        details=texts[1:],
        lead=("measured", "innovations"),
        head={
            "log": {
                "source": log.source, "samples": len(log), "duration_s": seconds, "period_s": log.period,
            },
            "robot": robot.name,
            "filter": {
                "kind": result.name, "form": filter.form, "period_s": filter.period,
                "process_noise": filter.process_noise, "measurement_noise": filter.measurement_noise,
                "sources": dict(result.sources), "gate": filter.gate,
                "bounds": {name: list(ends) for name, ends in filter.bounds.items()},
            },
            "fits": fits,
            "says": texts,
            "log_likelihood": result.data.attrs["log_likelihood"],
        },
    )  # fmt: skip


def _filter_rows(result: FilteredLog) -> list[Fact]:
    filter, sources = result.filter, result.sources
    noise = filter.measurement_noise
    start = zip(filter.plant.states, filter.initial.mean, strict=True)
    return [
        Fact("filter", result.name, "", "option --filter"),
        Fact("form", filter.form.replace("_", " "), "", "option --form"),
        Fact("period", filter.period, "s", sources["period"]),
        Fact("Rᵛ, diagonal", np.diag(filter.process_noise).tolist(), "per period", sources["process noise"]),
        Fact("Rⁿ, diagonal", np.diag(noise).tolist(), "", sources["measurement noise"]),
        *((Fact("gate", filter.gate, "", "option --gate"),) if filter.gate is not None else ()),
        *(
            Fact(f"bounds of {signal_label(name)}", [scale * end for end in ends], unit, "option --bounds")
            for name, ends in filter.bounds.items()
            for scale, unit in (result.units.of(name),)
        ),
        *(
            Fact(f"first {signal_label(name)}", scale * float(value), unit, "the first measurement")
            for name, value in start
            for scale, unit in (result.units.of(name),)
        ),
    ]


def _facts(result: FilteredLog) -> list[Fact]:
    judged, period = result.judged, result.log.period
    ratio = f"{number(judged.nis.interval[0], 3)} to {number(judged.nis.interval[1], 3)} is consistent"
    inside = float(
        np.average([o.inside for o in judged.outputs], weights=[o.samples for o in judged.outputs])
    )
    numbers = [
        Fact("samples", len(result.log), "", f"one in {number(1e3 * period, 3)} ms"),
        Fact("mean NIS", number(judged.nis.mean, 3), "", ratio),
        Fact("innovations in the band", number(100.0 * inside, 3), "%", "95 % are to be"),
        Fact("log-likelihood", number(result.data.attrs["log_likelihood"], 6), "", "larger fits better"),
    ]
    if judged.nees is not None:
        numbers.append(Fact("mean NEES", number(judged.nees.mean, 3), "", "1 is consistent"))
    return numbers


def estimate_table(data: xr.Dataset) -> dict[str, np.ndarray]:
    """The columns of a filtered log, as runs have them: ``estimate.link_position [rad]``; times first, s."""
    table: dict[str, np.ndarray] = {"time [s]": data["time"].values}
    for name, variable in data.data_vars.items():
        if variable.ndim == 1:
            table[str(name)] = variable.values
            continue
        kind = str(variable.dims[1]).removesuffix("_name")
        units = data[f"{kind}_unit"].values
        for k, signal in enumerate(data[f"{kind}_name"].values):
            table[f"{name}.{signal} [{units[k]}]" if units[k] else f"{name}.{signal}"] = variable.values[:, k]
    return table


def estimate_file(result: FilteredLog, kind: str) -> str | bytes:
    """The estimates as ``csv`` or ``parquet``."""
    columns = estimate_table(result.data)
    if kind == "parquet":
        arrow, parquet = (
            extra_package(name, "log", "Estimates in Parquet need another package.")
            for name in ("pyarrow", "pyarrow.parquet")
        )
        stream = arrow.BufferOutputStream()
        parquet.write_table(arrow.table(columns), stream)
        return stream.getvalue().to_pybytes()
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(columns)
    np.savetxt(text, np.column_stack(list(columns.values())), "%.12g", ",")
    return text.getvalue()
