"""How the weights were found: the preset, the tries of its search, and what the tolerances cost."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.page.weights_figure import search_figure
from flexhinf.design.page.weights_of import Weight, effort_unit, state_weights
from flexhinf.design.page.words import range_of
from flexhinf.design.presets.choose import DAMPING
from flexhinf.design.result import Design
from flexhinf.report import Column, Paragraph, Section, Table, number

__all__ = ["robust_rows", "some_tries", "try_rows", "weights_section"]

PRESETS = {
    "paper": "Preset paper: weights on positions and their integrals, as in Eq. (11) of the paper",
    "damped": "Preset damped: weights found for a behaviour",
    "robust": "Preset robust: weights found for a behaviour, every tolerance of the robot a disturbance channel",
    "given": "Weights as given",
}


def weights_section(design: Design) -> Section:
    """Preset, search, weights; for the robust preset what its channels cover and cost."""
    blocks: list[Any] = [Paragraph(_preset(design))]
    if design.game.found is not None:
        blocks += [Paragraph(_search(design)), search_figure(design), _tries(design)]
    if design.game.robustness is not None:
        blocks += [_robust(design), Paragraph(_robust_words(design))]
    return Section("Where the weights come from", (*blocks, *_weights(design)), "weights")


def _preset(design: Design) -> str:
    game = design.game
    return (
        f"{PRESETS[game.preset]} ({game.source}). Disturbances of the game: {', '.join(_kinds(design))}. Its "
        f"smallest level is γ* = {number(game.gamma_star)} (linear part); the law is made for "
        f"{design.specification.gamma_ratio:g} γ* = {number(game.gamma)}."
    )


def _kinds(design: Design) -> list[str]:
    """What disturbs, without repeating every joint."""
    names = design.problem.disturbance_names
    joints = design.robot.joint_names
    found = []
    for kind in ("link_position_command", "link_torque", "motor_torque"):
        stem = kind.removesuffix("_command")
        if any(name.startswith(stem) for name in names):
            found.append("command as disturbance" if kind.endswith("command") else kind.replace("_", " "))
    return found or [f"{len(names)} disturbances on {len(joints)} joints"]


def _search(design: Design) -> str:
    wanted, found = design.game.wanted, design.game.found
    assert wanted is not None
    assert found is not None
    return (
        "R2 is fixed; each joint has a pace ω, and all vibrations share one dial ζ. For each ζ the paces are moved "
        f"until every joint has its bandwidth of {range_of(wanted.bandwidth)} rad/s; ζ grows from 0 until every "
        f"oscillation is damped by {wanted.damping:g}, then is bisected to the least that does: {len(found.tries)} "
        "tries on the linear part. Every try is judged by its worst over the nominal robot and corners of its "
        f"tolerances, which is why the nominal robot gets more than was asked for.{_raised(design)}"
    )


def _raised(design: Design) -> str:
    """That the preset robust asks for more damping than the specification does."""
    wanted, asked = design.game.wanted, design.specification.damping
    assert wanted is not None
    asked = DAMPING if asked is None else asked
    if wanted.damping <= asked:
        return ""
    return (
        f" The damping was raised from {asked:g} to {number(wanted.damping, 3)}, until as few corners of the "
        "tolerances as possible are unstable with the estimator, over all Rᵛ that are looked at."
    )


def try_rows(design: Design) -> list[tuple[float, str, str, float, float, float, bool]]:
    """ζ, pace, bandwidth, worst and nominal damping, γ*, and whether it is the one; by ζ."""
    found = design.game.found
    assert found is not None
    return [
        (
            t.knob,
            range_of(t.pace),
            range_of(t.behaviour.bandwidth),
            t.behaviour.damping,
            t.behaviour.nominal_damping,
            t.design.gamma_star,
            t is found.chosen,
        )
        for t in sorted(found.tries, key=lambda t: t.knob)
    ]


def some_tries(rows: list[Any]) -> list[Any]:
    """The first, the last, that which is used, and its neighbours."""
    used = next(k for k, row in enumerate(rows) if row[-1])
    shown = {0, max(0, used - 1), used, min(len(rows) - 1, used + 1), len(rows) - 1}
    return [rows[k] for k in sorted(shown)]


def _tries(design: Design) -> Table:
    tries = try_rows(design)
    rows = [
        (
            *(_finite(value) if isinstance(value, float) else value for value in row[:-1]),
            "used" if row[-1] else "",
        )
        for row in some_tries(tries)
    ]
    columns = (
        Column("dial ζ", "", 3),
        Column("pace ω", "rad/s"),
        Column("bandwidth", "rad/s"),
        Column("damping, worst robot", "", 3),
        Column("damping, nominal robot", "", 3),
        "γ*",
        "",
    )
    caption = f"{len(rows)} of the {len(tries)} tries, by ζ; design.json has all"
    return Table(columns, rows, caption, "table-tries")


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def robust_rows(design: Design) -> list[tuple[str, float, float]]:
    """What, without the tolerances' channels, and with them."""
    r = design.game.robustness
    assert r is not None
    return [
        ("smallest level γ*", r.nominal_gamma_star, r.gamma_star),
        ("level that the nominal robot attains", r.nominal_gain, r.robust_gain),
    ]


def _robust(design: Design) -> Table:
    rows = [
        (what, plain, robust, 100.0 * (robust / plain - 1.0)) for what, plain, robust in robust_rows(design)
    ]
    columns = ("", "made without tolerances", "made with them", Column("cost", "%", 1))
    return Table(columns, rows, "What the tolerances cost (linear part)", "table-robust")


def _robust_words(design: Design) -> str:
    r = design.game.robustness
    assert r is not None
    whole = (
        "the whole of the stated tolerances" if r.share >= 1.0 else f"{number(100.0 * r.share, 3)} % of them"
    )
    return (
        f"{r.channels} channels stand for the tolerances; the game has a solution for {whole}"
        + ("" if r.share >= 1.0 else ", and nothing follows for robots outside that share")
        + ". Within it the level holds for every robot, on the linear part and with the true state fed back; draws of "
        f"the nonlinear loop with its estimator are below. Scalings s of the channels, each seen s times and entering "
        f"1/s times as strong: {_scalings(design)}."
    )


def _scalings(design: Design) -> str:
    assert design.game.robustness is not None
    found = sorted(design.game.robustness.scalings.items())
    return ", ".join(f"{group.replace('_', ' ')} {range_of(ends)}" for group, ends in found)


def _weights(design: Design) -> list[Any]:
    found, several = state_weights(design), len(design.robot.joint_names) > 1
    effort = np.asarray(design.problem.r2, dtype=float)
    diagonal = np.diagonal(effort) if effort.ndim == 2 else np.atleast_1d(effort)
    price = f"R2 = {range_of(diagonal)} {effort_unit(design)} ({design.game.effort_source})."
    if not found:
        return [Paragraph(f"The penalty of the states is code. {price}")]
    rows = [(name, values, unit) for (name, unit), values in _by_group(design).items()]
    caption = "The weights: h(x) has one entry for each" + (", in the order of the joints" if several else "")
    table = Table(("weight of", "value", "unit"), rows, caption, "table-weights")
    return [table, Paragraph(price)]


def _by_group(design: Design) -> dict[tuple[str, str], str]:
    """By signal without its joint, and unit: the weight of each joint, or the one of all; by joint in mixed units."""
    joints, groups = design.robot.joint_names, dict[str, list[Weight]]()
    for weight in state_weights(design):
        joint = next((name for name in joints if f"_{name}_" in f"{weight.signal}_"), "")
        name = weight.signal.replace(f"_{joint}", "", 1) if joint else weight.signal
        groups.setdefault(name.replace("_", " "), []).append(weight)
    found: dict[tuple[str, str], str] = {}
    for name, weights in groups.items():
        if len({weight.unit for weight in weights}) == 1:
            found[name, weights[0].unit] = _weight_words([weight.value for weight in weights], len(joints))
        else:
            found |= {(w.signal.replace("_", " "), w.unit): number(w.value) for w in weights}
    return found


def _weight_words(values: list[float], joints: int) -> str:
    if len(set(values)) == 1 and len(values) == joints:
        return number(values[0])
    return ", ".join(number(value) for value in values)
