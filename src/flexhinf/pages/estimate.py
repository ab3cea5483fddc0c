"""The page of a filtered log: how its innovations fit the filter, measured signals, estimates with their bands."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.identification.consistency import SMALL_CORRELATION, OutputConsistency, SquaredError
from flexhinf.numerals import number, number_text
from flexhinf.pages.drawing import Blocks, first_screen, listed, note, with_figures
from flexhinf.pages.estimate_figures import (
    BAND,
    FilteredLog,
    estimate_blocks,
    innovation_blocks,
    measured_blocks,
    signal_label,
)
from flexhinf.pages.log_findings import finding_numbers, finding_section, finding_texts
from flexhinf.pages.page import files_section
from flexhinf.pages.settings import Rows, robot_rows, settings_in_groups
from flexhinf.pages.terminal import Ending, table_screen
from flexhinf.report import (
    Badge,
    Cell,
    Column,
    KeyNumber,
    Page,
    Provenance,
    Section,
    Settings,
    Table,
    finite,
    house_style,
    to_json,
)
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


# Tables ------------------------------------------------------------------------------------------------
def innovation_table(result: FilteredLog) -> Table:
    """A row for each measured signal: how large its innovations are, and how related."""
    rows: list[Sequence[object]] = []
    for output in result.judged.outputs:
        test = output.whiteness
        fits = 1.0 / 1.1 < output.factor < 1.1
        rows.append(
            (
                signal_label(output.name),
                output.samples,
                result.units.text(output.name, output.rms),
                result.units.text(output.name, output.expected),
                Cell(number(output.factor, 3), "green" if fits else "yellow"),
                f"{number(100.0 * output.inside, 3)} %",
                None if test is None else number(test.correlations[0], 2),
                "too few" if test is None else Cell("yes", "green") if test.white else Cell("no", "yellow"),
            )
        )
    return Table(
        (
            "measured",
            Column("samples", brief=None),
            Column("innovation, rms", right=True, brief="rms"),
            Column("expected", right=True),
            Column("ratio", right=True),
            Column(f"in the {BAND}", right=True, brief="in 95 %"),
            Column("correlation of neighbours", right=True, brief="lag 1"),
            "white",
        ),
        rows,
        "Innovations, measured minus predicted, beside what the filter expects of them. White: no correlation over the "
        "first lags (Ljung and Box) that is certain and above 0.1, and slow changes with less than twice the power "
        "of white noise; what the steps of a sensor explain is taken off",
        "table-innovations",
        title="Innovations: measured minus predicted",
    )


def estimate_ending(result: FilteredLog, notes: Sequence[str] = ()) -> Ending:
    """What a terminal says at the end: the innovations of the first signals, what they say, and notes."""
    return table_screen(innovation_table(result), [" ".join(judgement(result)[1]).replace("`", ""), *notes])


def log_table(result: FilteredLog) -> Table:
    """What is in the log."""
    log = result.log
    steps = 1e3 * np.diff(log.times)
    usual, shortest, longest = (number(float(find(steps))) for find in (np.median, np.min, np.max))
    rows: list[Sequence[object]] = [
        ("samples", str(len(log))),
        ("duration", f"{number(float(log.times[-1] - log.times[0]))} s"),
        ("time between samples", f"{usual} ms, from {shortest} to {longest} ms"),
    ]
    plant = result.filter.plant
    for kind, names, values in (
        ("input", plant.inputs, log.inputs),
        ("measured", plant.outputs, log.outputs),
    ):
        for name, column in zip(names, values.T):
            (scale, unit), known = result.units.of(name), column[np.isfinite(column)]
            low, high = (
                number(scale * float(known.min()), 3),
                number_text(scale * float(known.max()), unit, 3),
            )
            part = "" if len(known) == len(log) else f", in {len(known)} of {len(log)} samples"
            rows.append((f"{kind}: {signal_label(name)}", f"{low} to {high}{part}"))
    return Table(("", "in the log"), rows, f"The log {log.source}", "table-log", stacks=True)


def innovations(result: FilteredLog) -> Blocks:
    """The table of the innovations, and their figures."""
    yield innovation_table(result)
    yield from innovation_blocks(result)


# The page, the files, the terminal -----------------------------------------------------------------------
def estimate_page(
    result: FilteredLog, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """The page of a filtered log; `command` makes it again, `warnings` are of the robot's file, `files` beside it."""
    fits, texts = judgement(result)
    log, robot = result.log, result.robot
    with house_style():
        blocks_of = with_figures(innovations(result), measured_blocks(result), estimate_blocks(result))
    names = (
        ("innovations", "Do the innovations fit the filter?"),
        ("signals", "Measured and predicted"),
        ("states", "Estimated states"),
    )
    sections = [Section(title, tuple(blocks), anchor) for (anchor, title), blocks in zip(names, blocks_of)]
    about = [note(text) for text in warnings]
    sections += [finding_section(result.findings), Section("The log", (*about, log_table(result)), "log")]
    if files:
        sections.append(files_section(files))
    unfolded = ("innovations", *(["findings"] if finding_texts(result.findings) else []))
    lead, sections = first_screen(sections, ("measured", "innovations"), unfolded)
    states = "fits the log" if fits else "does not fit the log"
    return Page(
        f"The log {log.source} and a filter for “{robot.name}”",
        f"A log of {len(log)} samples in {number(float(log.times[-1] - log.times[0]))} s, through the {result.name} of "
        f"the robot “{robot.name}”. Measured: {listed([signal_label(name) for name in result.filter.plant.outputs])}.",
        f"The filter {states}. {texts[0]}",
        sections,
        Settings(settings_in_groups({"Filter": _filter_rows(result), "Robot": robot_rows(robot)})),
        Provenance(shlex.join(command), None),
        _key_numbers(result),
        [Badge("met" if fits else "risky", f"The filter {states}.")],
        texts[1:],
        lead,
    )


def _filter_rows(result: FilteredLog) -> Rows:
    filter, sources = result.filter, result.sources
    noise = filter.measurement_noise
    start = zip(filter.plant.states, filter.initial.mean, strict=True)
    return [
        ("filter", result.name, "", "option --filter"),
        ("form", filter.form.replace("_", " "), "", "option --form"),
        ("period", filter.period, "s", sources["period"]),
        ("Rᵛ, diagonal", np.diag(filter.process_noise).tolist(), "per period", sources["process noise"]),
        ("Rⁿ, diagonal", np.diag(noise).tolist(), "", sources["measurement noise"]),
        *((("gate", filter.gate, "", "option --gate"),) if filter.gate is not None else ()),
        *(
            (f"bounds of {signal_label(name)}", [scale * end for end in ends], unit, "option --bounds")
            for name, ends in filter.bounds.items()
            for scale, unit in (result.units.of(name),)
        ),
        *(
            (f"first {signal_label(name)}", scale * float(value), unit, "the first measurement")
            for name, value in start
            for scale, unit in (result.units.of(name),)
        ),
    ]


def _key_numbers(result: FilteredLog) -> list[KeyNumber]:
    judged, period = result.judged, result.log.period
    ratio = f"{number(judged.nis.interval[0], 3)} to {number(judged.nis.interval[1], 3)} is consistent"
    inside = float(
        np.average([o.inside for o in judged.outputs], weights=[o.samples for o in judged.outputs])
    )
    numbers = [
        KeyNumber("samples", len(result.log), "", f"one in {number(1e3 * period, 3)} ms"),
        KeyNumber("mean NIS", number(judged.nis.mean, 3), "", ratio),
        KeyNumber("innovations in the band", number(100.0 * inside, 3), "%", "95 % are to be"),
        KeyNumber("log-likelihood", number(result.data.attrs["log_likelihood"], 6), "", "larger fits better"),
    ]
    if judged.nees is not None:
        numbers.append(KeyNumber("mean NEES", number(judged.nees.mean, 3), "", "1 is consistent"))
    return numbers


def innovation_numbers(result: FilteredLog) -> dict[str, object]:
    """What decides whether innovations fit, for the JSON of a page."""
    judged = result.judged

    def of(error: SquaredError | None) -> dict[str, object] | None:
        return (
            None
            if error is None
            else {
                "mean": error.mean,
                "interval": error.interval,
                "factor": error.factor,
                "samples": error.samples,
                "judgement": error.judgement,
            }
        )

    return {
        "nis": of(judged.nis),
        "nees": of(judged.nees),
        "outputs": {
            output.name: {
                "unit": output.unit,
                "samples": output.samples,
                "rms": output.rms,
                "expected": output.expected,
                "factor": output.factor,
                "bias": output.bias,
                "inside": output.inside,
                "rejected": rejected(result).get(output.name, 0),
                "step": output.step,
                "whiteness": output.whiteness
                and {
                    "white": output.whiteness.white,
                    "p_value": output.whiteness.p_value,
                    "correlations": output.whiteness.correlations,
                    "rounding": output.whiteness.rounding,
                },
            }
            for output in judged.outputs
        },
    }


def estimate_numbers(result: FilteredLog) -> dict[str, object]:
    """Every number of the page, for estimate.json."""
    log, filter, data = result.log, result.filter, result.data
    last = data.isel(time=-1)
    fits, texts = judgement(result)
    return finite(
        {
            "log": {
                "source": log.source,
                "samples": len(log),
                "duration_s": float(log.times[-1] - log.times[0]),
                "period_s": log.period,
            },
            "robot": result.robot.name,
            "filter": {
                "kind": result.name,
                "form": filter.form,
                "period_s": filter.period,
                "process_noise": filter.process_noise,
                "measurement_noise": filter.measurement_noise,
                "sources": dict(result.sources),
                "gate": filter.gate,
                "bounds": {name: list(ends) for name, ends in filter.bounds.items()},
            },
            "fits": fits,
            "says": texts,
            "findings": finding_numbers(result.findings),
            "log_likelihood": data.attrs["log_likelihood"],
            **innovation_numbers(result),
            "last_estimate": {
                name: {
                    "value": float(value),
                    "standard_deviation": float(deviation),
                    "unit": filter.plant.unit(name),
                }
                for name, value, deviation in zip(
                    filter.plant.states,
                    last["estimate"].values,
                    last["standard_deviation"].values,
                    strict=True,
                )
            },
        }
    )


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


def estimate_files(
    result: FilteredLog, command: Sequence[str], warnings: Sequence[str], table: str
) -> dict[str, str | bytes]:
    """The files of the report by name: the page, the numbers, and the estimates as ``csv`` or ``parquet``."""
    names = [f"estimate.{table}", "estimate.json"]
    columns = estimate_table(result.data)
    if table == "parquet":
        arrow, parquet = (
            extra_package(name, "log", "Estimates in Parquet need another package.")
            for name in ("pyarrow", "pyarrow.parquet")
        )
        stream = arrow.BufferOutputStream()
        parquet.write_table(arrow.table(columns), stream)
        written: str | bytes = stream.getvalue().to_pybytes()
    else:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(columns)
        np.savetxt(text, np.column_stack(list(columns.values())), "%.12g", ",")
        written = text.getvalue()
    page = estimate_page(result, command, warnings, names)
    return {"index.html": page.html(), names[0]: written, names[1]: to_json(estimate_numbers(result))}
