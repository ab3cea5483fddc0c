"""The figures of README.md, for docs/make.py: moves of a design for the workspace; a step beside a rigid design."""

from __future__ import annotations

import textwrap

import numpy as np

#: Moves that are drawn.
DRAWN = 5


def moves() -> tuple[str, str]:
    """The drawing (SVG) of some moves between random goals of two links, and the text of all moves and poses."""
    import flexhinf as fh
    from flexhinf.design.plans import SPEED, UNLIMITED
    from flexhinf.pages.workspace_summary import worst_motion
    from flexhinf.report import INK, SERIES, figure_to_svg, label, legend, new_figure

    specification = fh.Specification(measured=("link_position", "motor_position"))
    found = fh.design(fh.load_robot("planar-two-link"), specification)
    assert found.met
    drawing, (above, below) = new_figure(2, width=4.6, height=4.4)
    begin = 0.0
    for number, move in enumerate(found.sampled[:DRAWN]):
        time = begin + move.response.run.time
        for k, (joint, colour) in enumerate(zip(move.response.joints, SERIES)):
            name = joint if number == 0 else "_"
            above.plot(time, np.degrees(move.response.positions[:, k]), color=colour, label=name)
            below.plot(time, 1e3 * move.error[:, k], color=colour)
        begin = time[-1]
        for panel in (above, below):
            panel.axvline(begin, color=INK, linewidth=0.6, alpha=0.3)
    label(above, "link angle", "°")
    label(below, "off the path", "mrad")
    legend(above)
    drawing.set_facecolor("white")
    (own, sampled) = (
        {key: max(row[key] for row in rows) for key in rows[0]}
        for rows in (worst_motion(found.moves), worst_motion(found.sampled))
    )
    picture = (
        "![Five moves of two-link arms between random goals: angles of both links, and their distances from the "
        "path, over time](docs/images/moves.svg)"
    )
    left, best_left = 1e3 * sampled["remaining_error"], 1e3 * own["remaining_error"]
    off, best_off = 1e3 * sampled["path_distance"], 1e3 * own["path_distance"]
    text = (
        f"The figure shows {DRAWN} moves between random goals with [the controller "
        "below](#one-controller-for-the-whole-workspace), with dry friction, noisy encoders and one sample of latency. "
        "Each move is made by another robot at a corner of its tolerances, which the controller does not know. It "
        "begins at rest, where the loop has held the arm. The robot's file has no "
        f"speed limits, so a link moves at up to {SPEED * UNLIMITED:g} rad/s. "
        f"Of {len(found.sampled)} such moves at most {left:.2f} mrad remain "
        f"({best_left:.2f} mrad with the nominal robot), no link is further off its path than {off:.1f} mrad "
        f"({best_off:.1f} mrad) or goes the wrong way by more than {sampled['wrong_way_percent']:.2f} % of its travel. "
        f"At {len(found.loops)} random poses every oscillation below {found.specification.damped_below_limit:g} rad/s "
        f"has a damping ratio of {min(loop.damping for loop in found.loops):.2f} or more."
    )
    return figure_to_svg(drawing), f"{picture}\n\n{textwrap.fill(text, 150, break_on_hyphens=False)}"


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
        "The figure shows the step of this design: both links from hanging to "
        f"{np.degrees(ours.goal[0]):.0f}° and {np.degrees(ours.goal[1]):.0f}°. Solid lines are the design, with its "
        f"estimator and noisy encoders: it settles in {last.value:.2f} s, overshoots by {passed.value:.1f} % and needs "
        f"{ours.peak_input:.1f} V. Dashed lines are a design with the same weights for a robot with rigid joints, "
        "which is fed the true positions and velocities of the motors: "
        f"{slow.value:.2f} s, {over.value:.1f} % and {theirs.peak_input:.1f} V. Fed those of the links it is "
        f"{'stable' if rigid['link'].stable else 'unstable'}."
    )
    made = f"{picture}\n\n{textwrap.fill(text, 150, break_on_hyphens=False)}"
    return figure_to_svg(drawing), made
