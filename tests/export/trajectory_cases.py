"""What joint_trajectory_controller documents of trajectories, and what the exported package does: the table of
docs/ros2.md. `test_ros2_trajectories.py` runs every row and compares its result."""

from __future__ import annotations

from typing import NamedTuple


class TrajectoryCase(NamedTuple):
    """`documented`: by joint_trajectory_controller; `here`: what the package does; `result`: how the goal ends, with
    its error code."""

    name: str
    documented: str
    here: str
    result: str


CASES = tuple(
    TrajectoryCase(*map(str.strip, line.split("|")))
    for line in """
    shuffled names | joints in any order | the same | succeeded, 0
    linear, cubic, quintic | by what two waypoints state | the same, then smoothed | succeeded, 0
    one waypoint | taken | the same | succeeded, 0
    first waypoint at time 0 | taken | the same | succeeded, 0
    waypoint without positions | rejected by default | the same, always | rejected
    waypoints of mixed kinds | by what both ends of a segment state | the same | succeeded, 0
    empty goal | rejected | the same | rejected
    unknown joint | rejected | the same | rejected
    joint left out | rejected by default | the same | rejected
    joint left out, `allow_partial_joints_goal` | it holds, since 6.8 it goes on | it rests, then holds | succeeded, 0
    times that do not increase | rejected | the same | rejected
    efforts | rejected without an effort interface | rejected | rejected
    number that is not finite | not documented | rejected | rejected
    speed at the end | above 1.2e-7 rejected by default | the same, always | rejected
    beyond the joint's range | not looked at | rejected | rejected
    beyond range or speed between waypoints | not looked at | rejected | rejected
    beyond range or speed from where it is | not looked at | aborted, what there is goes on | aborted, −1
    jump between waypoints | not looked at | rejected | rejected
    jump from where it is | not looked at | aborted, what there is goes on | aborted, −1
    goal before one that cannot start | ends | goes on | succeeded, 0
    past stamp, over | rejected | the same | rejected
    past stamp, partly | goes on with waypoints still to come | the same, from the motion of now | succeeded, 0
    future stamp | begins then | the same | succeeded, 0
    goal before one with a future stamp | ends | goes on until then | succeeded, 0
    replaced at speed | the goal before ends | the same, with −1; velocity and acceleration continue | succeeded, 0
    cancelled at speed | holds at once; decelerates by option | decelerates in `stop_time` | cancelled, 0
    cancelled before it begins | holds | the goal before it goes on | cancelled, 0
    cancel without an open goal | nothing | what moves comes to rest | held
    goal tolerance missed | aborted after `goal_time` | the same | aborted, −5
    moving at the goal | aborted after `goal_time` | the same | aborted, −5
    goal time 0 | waits without end | the same | followed
    path tolerance | aborted beyond it; holds | the same, after decelerating | aborted, −4
    path tolerance 0 | that of the parameters | the same | aborted, −4
    path tolerance, unstated | none | what braking takes | aborted, −4
    controller brakes | not documented | ends when the path stands | aborted, −4
    path tolerance −1 | none, whatever the parameters | the same | succeeded, 0
    other negative tolerance | an error is logged, the parameters are used | rejected | rejected
    time-out | `cmd_timeout` after the end: holds | the same, and the goal is aborted | aborted, −5
    speed scaling | an interface or a topic scales time | an interface, 0 to 1; smoothly, at rest at once | succeeded, 0
    fault in mid-move | not documented | the controller stops; the result's text says so | aborted, −4
    deactivated, then active at another pose | holds the last command; by option the pose | the new pose | aborted, −4
    not active | rejected | the same | rejected
    topic | no result; not said of a goal of the action | no result; a goal of the action ends | aborted, −1
    topic, path tolerance | aborted beyond it; holds | the same, after decelerating | held
    two publishers that fight | the last counts | the same; named in log and `health` | contested
    one publisher at 50 Hz | followed | the same | followed
    empty trajectory on the topic | overrides the goal, without ending it | ignored; the goal goes on | succeeded, 0
    """.strip().splitlines()
)


def table() -> str:
    """The rows in Markdown; cases of one answer share a row."""
    names: dict[tuple[str, ...], list[str]] = {}
    for name, *answer in CASES:
        names.setdefault(tuple(answer), []).append(name)
    head = ("case", "joint_trajectory_controller", "this package", "result")
    rows = [("; ".join(cases), *answer) for answer, cases in names.items()]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [head, ("---",) * len(head), *rows])
