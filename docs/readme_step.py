"""The figure of README.md, for docs/make.py: what a design gives, beside a rigid design."""

from __future__ import annotations

import textwrap

import numpy as np


def step() -> tuple[str, str]:
    """The drawing (SVG) of a step of two links by a design, and by the same weights for a rigid robot; and its text."""
    import flexhinf as fh
    from flexhinf.report import INK, SERIES, figure_to_svg, label, legend, new_figure, reference_line

    pose, measured = ("45deg", "60deg"), ("link_position", "motor_position")
    specification = fh.Specification(pose=pose, start=(0.0, 0.0), bandwidth=6.0, measured=measured)
    found = fh.design(fh.load_robot("planar-two-link"), specification)
    assert found.met
    assert found.rigid is not None
    rigid = {loop.side: loop for loop in found.rigid.loops}
    ours, theirs = found.evaluation.step, rigid["motor"].response
    drawing, (above, below) = new_figure(
        2, width=4.6, height=4.4
    )  # narrow, so that text stays large on a telephone
    for angle, name in zip(np.degrees(ours.goal), ("command", "_")):
        reference_line(above, ours.run.time, np.full(len(ours.run.time), angle), name)
    for k, (joint, colour) in enumerate(zip(ours.joints, SERIES)):
        for panel, mine, other in (
            (above, np.degrees(ours.positions), np.degrees(theirs.positions)),
            (below, ours.inputs, theirs.inputs),
        ):
            panel.plot(ours.run.time, mine[:, k], color=colour, label=joint)
            panel.plot(theirs.run.time, other[:, k], color=colour, linewidth=1.3, dashes=(3.0, 1.5))
    above.plot([], [], color=INK, linewidth=1.3, dashes=(3.0, 1.5), label="rigid design")
    label(above, "link angle", "°")
    unit = found.setup.model.unit(found.setup.model.inputs[0])
    assert unit == "V"
    label(below, "motor voltage", unit)
    legend(above)
    drawing.set_facecolor("white")  # readable on dark pages too
    last, passed = ours.settling, ours.overshoot
    slow, over = theirs.settling, theirs.overshoot
    picture = (
        "![Step of a two-link arm: angles of both links and voltages of both motors over time, by the design and, "
        "dashed, by a rigid design that rings](docs/images/step.svg)"
    )
    text = (
        "The figure shows the step of [the design below](#your-own-robot): both links from hanging to "
        f"{np.degrees(ours.goal[0]):.0f}° and {np.degrees(ours.goal[1]):.0f}°. Solid lines are the design, with its "
        f"estimator and noisy encoders: it settles in {last.value:.2f} s, overshoots by {passed.value:.1f} % and needs "
        f"{ours.peak_input:.1f} V. Dashed lines are a design with the same weights for a robot with rigid joints, "
        "which is fed the true positions and velocities of the motors: "
        f"{slow.value:.2f} s, {over.value:.1f} % and {theirs.peak_input:.1f} V. Fed those of the links it is "
        f"{'stable' if rigid['link'].stable else 'unstable'}."
    )
    made = f"{picture}\n\n{textwrap.fill(text, 150, break_on_hyphens=False)}"
    return figure_to_svg(drawing), made
