"""Figures for docs/make.py: an arm with and without control of its springs; moves; a step."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

#: Moves that are drawn.
DRAWN = 5


#: Of the moving picture: how long the arm moves and how long it is watched, s; and its frames per second.
MOVING, WATCHED, RATE = 0.4, 4.0, 25

#: Natural frequency, rad/s, and damping ratio of the PD of the moving picture, for motors without springs.
STIFF, DAMPED = 80.0, 0.7


def swing() -> tuple[str, str]:
    """The moving drawing (SVG) of two links with the design for the workspace, and with a PD on the motors."""
    import flexhinf as fh

    robot, start, goal = fh.load_robot("planar-two-link"), (0.0, 0.0), (0.8, 1.0)
    measured = ("link_position", "motor_position")
    found = fh.design(robot, fh.Specification(measured=measured, saturation=48.0, peak_speed=8.0))
    plan = fh.Waypoints([0.0, MOVING], [start, goal], "quintic")
    loop = fh.Loop(found.loop.setup.true_plant, found.controller(at=start), found.loop.setup.sub_steps)
    reference = fh.Moving(plan, robot.inverse_dynamics)
    state = robot.operating_point(start)[0]
    run = loop.run(reference=reference, duration=WATCHED, initial_state=state)
    ours, theirs = run.signals["state"][:, :2], held_by_motors(robot, plan)
    late = run.time > MOVING + 0.1
    left, ringing = (np.degrees(np.abs(q[: len(late)][late[: len(q)]] - goal).max()) for q in (ours, theirs))
    text = (
        f"Two links move by {np.degrees(goal[0]):.0f}° and {np.degrees(goal[1]):.0f}° in {MOVING:g} s. Left: the "
        f"controller of `flexhinf design`; 0.1 s later both links are within {left:.2g}° of the goal. "
        f"Right: a PD on the motor encoders, tuned to {STIFF:g} rad/s, with gravity compensation; the links "
        f"swing by {ringing:.0f}°. Smooth slow moves suit both."
    )
    picture = (
        "![Two-link arm with elastic joints in motion: left it stops at once, right it swings for seconds]"
        "(docs/images/swing.svg)"
    )
    steps = np.arange(0, round(WATCHED * 1e3), round(1e3 / RATE))
    return animated(robot, ours[steps], theirs[steps], goal), f"{picture}\n\n{textwrap.fill(text, 150)}"


def held_by_motors(robot: Any, plan: Any) -> np.ndarray:
    """Link positions (N, 2) at every millisecond with a PD on the motors, by Runge and Kutta's method."""
    plant, period = robot.plant(), 1e-3
    times = period * np.arange(round(WATCHED / period))
    places = np.reshape(plan(times), (-1, 2))
    still = np.zeros_like(places)
    rest, inputs = robot.inverse_dynamics(places, still, still, still, still)
    speeds = np.gradient(rest[:, 4:6], period, axis=0)
    slope = plant.linearise(rest[0])[1][6:]

    def flow(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        nothing = np.zeros(len(plant.disturbances))
        return np.asarray(plant.evaluate_flow(x, u, nothing, plant.parameters.vector()), dtype=float)

    x, found = rest[0], []
    for k in range(len(times)):
        found.append(x[:2])
        error = STIFF**2 * (rest[k, 4:6] - x[4:6]) + 2.0 * DAMPED * STIFF * (speeds[k] - x[6:])
        u = inputs[k] + np.linalg.solve(slope, error)
        k1 = flow(x, u)
        k2 = flow(x + 0.5 * period * k1, u)
        k3 = flow(x + 0.5 * period * k2, u)
        x = x + period / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + flow(x + period * k3, u))
    return np.array(found)


def animated(robot: Any, ours: np.ndarray, theirs: np.ndarray, goal: Any) -> str:
    """Two arms side by side that move over and over, above their link angles, as SVG that moves by itself."""
    from flexhinf.report import INK, MUTED, SERIES
    from flexhinf.robot.kinematics import skeleton

    def points(q: Any, middle: float) -> str:
        lines = skeleton(robot, q)
        corners = [*(line[0] for line in lines), lines[-1][-1]]
        return " ".join(f"{middle + 240.0 * c[1]:.1f},{40.0 + 240.0 * c[0]:.1f}" for c in corners)

    times, seconds = np.arange(len(ours)) / RATE, len(ours) / RATE
    most = float(np.degrees(max(np.abs(ours).max(), np.abs(theirs).max())))
    parts = []
    for middle, name, q in ((70.0, "flexhinf", ours), (390.0, "PD on the motors", theirs)):
        frames = ";".join(points(row, middle) for row in q)
        moving = (
            f'<animate attributeName="points" values="{frames}" dur="{seconds:g}s" repeatCount="indefinite"/>'
        )
        parts += [
            f'<text x="{middle + 90}" y="22" text-anchor="middle" font-weight="bold">{name}</text>',
            f'<polyline points="{points(goal, middle)}" stroke="{MUTED}" stroke-width="3" stroke-dasharray="3 6"/>',
            f'<polyline points="{points(q[-1], middle)}" stroke="{INK}" stroke-width="9">{moving}</polyline>',
            f'<circle cx="{middle}" cy="40" r="8" fill="{INK}" stroke="none"/>',
        ]
        left, width, bottom, high = middle - 45.0, 250.0, 420.0, 110.0
        for column, colour in zip(np.degrees(q).T, SERIES):
            curve = " ".join(
                f"{left + width * t / seconds:.1f},{bottom - high * a / most:.1f}"
                for t, a in zip(times, column)
            )
            parts.append(f'<polyline points="{curve}" stroke="{colour}" stroke-width="2"/>')
        for joint, colour, along in zip(robot.joint_names, SERIES, (0.55, 1.0)):
            x = left + along * width
            parts.append(
                f'<text x="{x}" y="{bottom - 8}" text-anchor="end" style="fill:{colour}">{joint}</text>'
            )
        right, over = left + width, f'dur="{seconds:g}s" repeatCount="indefinite"'
        cursor = f'<animate attributeName="x1" from="{left}" to="{right}" {over}/>'
        cursor += cursor.replace("x1", "x2")
        parts += [
            f'<line x1="{left}" x2="{right}" y1="{bottom}" y2="{bottom}" stroke="{MUTED}"/>',
            f'<line x1="{right}" x2="{right}" y1="{bottom - high}" y2="{bottom}" stroke="{MUTED}">{cursor}</line>',
            f'<text x="{left}" y="{bottom - high - 8}">link angles, up to {most:.0f}°</text>',
            f'<text x="{right}" y="{bottom + 18}" text-anchor="end">{seconds:g} s</text>',
        ]
    body = "\n".join(parts)
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 620 450" font-family="sans-serif" font-size="19" '
        f'fill="none" stroke-linecap="round" stroke-linejoin="round"><style>text {{fill: {INK}}}</style>'
        f'<rect width="620" height="450" fill="white"/>\n{body}\n</svg>\n'
    )


def moves() -> tuple[str, str]:
    """The drawing (SVG) of some moves between random goals of two links, and the text of all moves and poses."""
    import flexhinf as fh
    from flexhinf.designs.plans import SPEED, UNLIMITED
    from flexhinf.pages.workspace_summary import worst_motion
    from flexhinf.report import INK, SERIES, figure_to_svg, label, legend, new_figure

    specification = fh.Specification(measured=("link_position", "motor_position"))
    found = fh.design(fh.load_robot("planar-two-link"), specification).evidence
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
        "path, over time](images/moves.svg)"
    )
    left, best_left = 1e3 * sampled["remaining_error"], 1e3 * own["remaining_error"]
    off, best_off = 1e3 * sampled["path_distance"], 1e3 * own["path_distance"]
    text = (
        f"The figure shows {DRAWN} moves between random goals with this "
        "controller, with dry friction, noisy encoders and one sample of latency. "
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
    """The drawing (SVG) of a step of two links by a design, and its text."""
    import flexhinf as fh
    from flexhinf.report import SERIES, figure_to_svg, label, legend, new_figure, reference_line

    pose, measured = ("45deg", "60deg"), ("link_position", "motor_position")
    specification = fh.Specification(pose=pose, start=(0.0, 0.0), bandwidth=6.0, measured=measured)
    found = fh.design(fh.load_robot("planar-two-link"), specification).evidence
    assert found.met
    ours = found.evaluation.step
    drawing, (above, below) = new_figure(
        2, width=4.6, height=4.4
    )  # narrow, so that text stays large on a telephone
    for angle, name in zip(np.degrees(ours.goal), ("command", "_")):
        reference_line(above, ours.run.time, np.full(len(ours.run.time), angle), name)
    for k, (joint, colour) in enumerate(zip(ours.joints, SERIES)):
        for panel, values in ((above, np.degrees(ours.positions)), (below, ours.inputs)):
            panel.plot(ours.run.time, values[:, k], color=colour, label=joint)
    label(above, "link angle", "°")
    unit = found.setup.model.unit(found.setup.model.inputs[0])
    assert unit == "V"
    label(below, "motor voltage", unit)
    legend(above)
    drawing.set_facecolor("white")  # readable on dark pages too
    last, passed = ours.settling, ours.overshoot
    picture = "![Step of a two-link arm: angles of both links and voltages of both motors over time](images/step.svg)"
    text = (
        "The figure shows the step of this design: both links from hanging to "
        f"{np.degrees(ours.goal[0]):.0f}° and {np.degrees(ours.goal[1]):.0f}°, with its "
        f"estimator and noisy encoders. It settles in {last.value:.2f} s, overshoots by {passed.value:.1f} % and needs "
        f"{ours.peak_input:.1f} V."
    )
    made = f"{picture}\n\n{textwrap.fill(text, 150, break_on_hyphens=False)}"
    return figure_to_svg(drawing), made
