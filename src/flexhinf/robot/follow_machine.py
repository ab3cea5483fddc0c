"""The state machine of `Follower`: goals, the path through their waypoints, how they end.

It is written once, with `follow_pieces` and `follow_records`. Python runs it as it stands, and
`flexhinf.codegen.c.source` writes the same text as C: it has numbers, arrays of fixed sizes, records, branches and
loops, and no more. Of `own` is what a robot and a controller fix, constants in C. A goal has a number, 0 for one that
nobody asks about; whoever starts or cancels one, or makes a sample, then reads which goals have ended (`State.ends`).
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from flexhinf.codegen.c.source import room, zeros
from flexhinf.robot.follow_limits import FollowLimits
from flexhinf.robot.follow_pieces import (
    at_point,
    between,
    column,
    leaves,
    spanned,
    spent_after,
)
from flexhinf.robot.follow_records import (
    FollowCode,
    FollowReason,
    Goal,
    Input,
    Joints,
    Long,
    Motion,
    Options,
    Output,
    State,
    Three,
)

#: Points of a path that one sample may pass, which bounds its time: nearer ones are refused.
PASSED = 16

#: Samples that are counted at most: a goal that waits longer begins then, one that ends is late by no more.
MOST_COUNTED = 2_000_000_000

#: Samples of a goal whose commands are judged at most: a longer one is refused where drives limit them.
MOST_JUDGED = 1_000_000

#: Largest velocity of a last waypoint that counts as rest, rad/s or m/s: float's epsilon, as in
#: joint_trajectory_controller.
RESTING = 2.0**-23

#: For so long after the last goal that led back, and from so long on, goals that replace one another are a quarrel, s.
CALM, QUARREL = 0.5, 1.0


def share(value: float) -> float:
    """A number from 0 to 1; 0 for what is none."""
    return min(max(value, 0.0), 1.0) if math.isfinite(value) else 0.0


def counted(samples: Long) -> Long:
    """One sample more, as far as they are counted."""
    return min(samples + 1, MOST_COUNTED)


# What drives take --------------------------------------------------------------------------------------
def hurries(own: FollowLimits, j: int, begin: Three, end: Three, time: float, order: int) -> int:
    """Whether the way of joint j between two waypoints is quicker than its drive takes."""
    place, speed, change = room(6), room(6), room(6)
    degree = spanned(begin, end, time, order, place, speed)
    for i in range(degree - 1):
        change[i] = float(degree - 1) * (speed[i + 1] - speed[i]) / time
    found = leaves(speed, degree - 1, -own.quickest[j], own.quickest[j])
    if order > 1:
        found += leaves(change, degree - 2, -own.hardest[j], own.hardest[j])
    return found


def behind(goal: Goal, i: int, j: int) -> float:
    """Velocity of joint j just behind waypoint i."""
    value = 0.0
    if i + 1 < goal.count:
        point, after = goal.points[i], goal.points[i + 1]
        is_linear = 1 if point.order == 1 or after.order == 1 else 0
        way = after.position[j] - point.position[j]
        value = way / (after.time - point.time) if is_linear != 0 else point.velocity[j]
    return value


def begins_quickly(own: FollowLimits, goal: Goal, i: int, j: int, begin: Three, time: float) -> int:
    """Whether joint j is quicker than its drive takes on the way to waypoint i in a time, or there."""
    end = room(3)
    at_point(goal.points[i], j, end)
    found = hurries(own, j, begin, end, time, goal.points[i].order)
    if goal.points[i].order == 1:
        slope = (end[0] - begin[0]) / time
        first, last = abs(slope - begin[1]), abs(behind(goal, i, j) - slope)
        bend = first + last if time < own.delay else max(first, last)  # nearer ones add up
        if bend * own.bent_rates[j] > own.rates[j] or bend * own.bent_changes[j] > own.changes[j]:
            found = 1
    return found


def is_quick(own: FollowLimits, options: Options, goal: Goal) -> int:
    """Whether drives do not take the commands from the first waypoint on, with the joints that are left out at home;
    the way to that waypoint is judged when it begins."""
    one = State(own)
    motion = zeros(3, own.joints)
    command, rate, inputs = zeros(own.joints), zeros(own.joints), room(own.joints)
    time = 0.0
    found, k = 0, 0
    if goal.count > 1:
        time = goal.points[goal.count - 1].time - goal.points[0].time
    if time > float(MOST_JUDGED) * own.period:
        found = 1
    if found == 0 and time > 0.0:
        first = goal.points[0]
        for j in range(own.joints):
            motion[0][j] = own.home[j]
            if goal.moves[j] != 0:
                motion[0][j] = first.position[j]
                motion[1][j] = first.velocity[j] if first.order > 1 else 0.0
                motion[2][j] = first.acceleration[j] if first.order > 2 else 0.0
                if first.order == 1 and first.time > 0.0:  # it has that velocity already
                    motion[1][j] = behind(goal, 0, j)
        stand_at(own, one, motion[0])
        for j in range(own.joints):
            for i in range(own.samples):
                age = own.period * float(i)
                way = age * (motion[1][j] - 0.5 * age * motion[2][j])
                one.path[(own.samples - i) % own.samples][j] = motion[0][j] - way
            one.now[1][j] = motion[1][j]
            one.now[2][j] = motion[2][j]
        follow(own, one, options, goal, 1, goal.points[1].time - first.time)
        while rests(one) == 0:
            push(own, one, 1.0)
            commanded(own, one.motion[1], inputs)
            for j in range(own.joints):
                changed = (inputs[j] - command[j]) / own.period
                rounded = own.ulps * abs(inputs[j]) / own.period
                faster = (abs(changed - rate[j]) - rounded) / own.period
                if (k > 0 and abs(changed) > own.rates[j] + rounded) or (k > 1 and faster > own.changes[j]):
                    found = 1
                command[j] = inputs[j]
                rate[j] = changed
            k = min(k + 1, 2)
    return found


# Stops -------------------------------------------------------------------------------------------------
def time_to(way: float, velocity: float, acceleration: float) -> float:
    """Duration of the stop, from this velocity and acceleration, that takes a way: T (v/2 + T a/12) = way."""
    root = math.sqrt(max(0.25 * velocity * velocity + acceleration * way / 3.0, 0.0))
    divisor = (0.5 * velocity if way >= 0.0 else -0.5 * velocity) + root
    return 2.0 * abs(way) / divisor if divisor > 0.0 else 0.0


def stopping(own: FollowLimits, state: State, j: int, result: Three) -> None:
    """Where joint j comes to rest from the motion at the beginning of the goal; sooner where its range ends."""
    begin, end, time = room(3), zeros(3), state.stop_time
    column(state.begun, j, begin)
    low, high = min(own.low[j], begin[0]), max(own.high[j], begin[0])
    end[0] = begin[0] + time * (0.5 * begin[1] + time * begin[2] / 12.0)
    if not low <= end[0] <= high:
        end[0] = low if end[0] < low else high
        time = min(max(time_to(end[0] - begin[0], begin[1], begin[2]), own.smoothing), time)
    if state.age >= time:
        for k in range(3):
            result[k] = end[k]
    else:
        between(begin, end, time, state.age, 3, result)


# The path ----------------------------------------------------------------------------------------------
def length(state: State) -> float:
    """Time from one waypoint to the next."""
    time = state.first
    if time < 0.0:
        time = state.goal.points[state.segment].time - state.goal.points[state.segment - 1].time
    return time


def is_over(state: State) -> int:
    """Whether the path is at its end, where it rests."""
    ended = 1 if state.stops != 0 or state.segment == state.goal.count else 0
    return 1 if ended != 0 and state.age >= state.stopped_at else 0


def rests(state: State) -> int:
    """Whether the smoothed motion rests at the end too."""
    return 1 if is_over(state) != 0 and state.left == 0 else 0


def is_left_out(state: State, j: int) -> int:
    """Whether joint j comes to rest, of a goal that leaves it out, or as there is none."""
    return 1 if state.stops != 0 or state.goal.moves[j] == 0 else 0


def advance(own: FollowLimits, state: State, time: float) -> None:
    """The path so much later."""
    begin, end, result = room(3), room(3), room(3)
    state.since += time
    state.age = min(state.age + time, state.stop_time)
    while state.stops == 0 and state.segment < state.goal.count and state.since >= length(state):
        state.since -= length(state)
        state.segment += 1
        state.first = -1.0
    for j in range(own.joints):
        if is_left_out(state, j) != 0:
            stopping(own, state, j, result)
        elif state.segment == state.goal.count:
            at_point(state.goal.points[state.goal.count - 1], j, end)
            between(end, end, 1.0, 0.0, 1, result)  # at rest there
        else:
            order = state.goal.points[state.segment].order
            at_point(state.goal.points[state.segment], j, end)
            column(state.begun, j, begin)
            if state.first < 0.0:
                at_point(state.goal.points[state.segment - 1], j, begin)
                order = min(order, state.goal.points[state.segment - 1].order)
            between(begin, end, length(state), state.since, order, result)
        for k in range(3):
            state.now[k][j] = result[k]


def moves(own: FollowLimits, state: State) -> int:
    """Whether the path has a velocity or an acceleration."""
    found = 0
    for j in range(own.joints):
        if abs(state.now[1][j]) + abs(state.now[2][j]) > 0.0:
            found = 1
    return found


def push(own: FollowLimits, state: State, speed: float) -> None:
    """The next sample of the path, and the motion that the last ones give."""
    most = own.period / state.stop_time
    if moves(own, state) == 0:
        state.speed = speed
    elif state.stops == 0:  # a stop is in true time
        state.speed = min(max(speed, state.speed - most), state.speed + most)
    advance(own, state, own.period * state.speed)
    last = state.newest
    state.newest = (last + 1) % own.samples
    for j in range(own.joints):
        if own.paced:
            way = abs(state.now[0][j] - state.path[last][j])
            state.spent[j] = max(state.spent[j] + way - own.peak[j] * own.period, 0.0)
        state.path[state.newest][j] = state.now[0][j]
        for k in range(5):
            state.motion[0][k][j] = state.motion[1][k][j]
    smooth(own, state.path, state.newest, state.motion[1])
    if is_over(state) != 0:
        state.left = max(state.left - 1, 0)


# Goals -------------------------------------------------------------------------------------------------
def tell(state: State, number: Long, code: int, reason: int) -> None:
    """Say how a goal ended."""
    if number > 0:
        state.ends[state.ended].number = number
        state.ends[state.ended].code = code
        state.ends[state.ended].reason = reason
        state.ended += 1


def drop(state: State, code: int, reason: int) -> None:
    """End the goal that waits."""
    if state.has_next != 0:
        state.has_next = 0
        tell(state, state.next.number, code, reason)


def end_all(state: State, code: int, reason: int) -> None:
    """End every goal; the motion goes on as it is."""
    state.ended = 0
    if state.active != 0:
        state.active = 0
        tell(state, state.goal.number, code, reason)
    drop(state, code, reason)


def begin_from_here(own: FollowLimits, state: State, stop_time: float) -> None:
    """Begin with a goal or a stop from the motion of now."""
    state.since = 0.0
    state.age = 0.0
    state.stop_time = stop_time
    state.stopped_at = 0.0
    for j in range(own.joints):
        for k in range(3):
            state.begun[k][j] = state.now[k][j]
        if is_left_out(state, j) != 0 and abs(state.now[1][j]) + abs(state.now[2][j]) > 0.0:
            state.stopped_at = stop_time
    state.left = own.samples
    state.late = 0


def stop(own: FollowLimits, state: State, options: Options) -> None:
    """Come to rest in true time, which a speed of 0 does not hold up."""
    for j in range(own.joints):
        state.now[1][j] *= state.speed
        state.now[2][j] *= state.speed * state.speed
    state.stops = 1
    state.active = 0
    state.speed = 1.0
    begin_from_here(own, state, options.stop_time)


def contest(own: FollowLimits, state: State, goal: Goal) -> None:
    """Notice goals that lead back and forth, each before the one before has ended."""
    back = 0
    for j in range(own.joints):
        if goal.moves[j] != 0:
            target = goal.points[goal.count - 1].position[j]
            turn = target - state.target[j] if state.active != 0 else 0.0
            least = min(abs(turn), abs(state.turn[j]))
            if turn * state.turn[j] < 0.0 and least > own.farthest[j]:
                back = 1
            state.target[j] = target
            state.turn[j] = turn
    if back != 0:
        state.contested = max(state.contested, 1)
        state.calm = 0


def follow(own: FollowLimits, state: State, options: Options, goal: Goal, i: int, time: float) -> None:
    """Follow a goal from the motion of now to waypoint i in a time; those before it end."""
    contest(own, state, goal)
    if state.active != 0:
        tell(state, state.goal.number, FollowCode.INVALID_GOAL, FollowReason.REPLACED)
    drop(state, FollowCode.INVALID_GOAL, FollowReason.REPLACED)
    state.goal = goal
    state.stops = 0
    state.segment = i
    state.first = time
    state.active = 1
    begin_from_here(own, state, options.stop_time)


def take(own: FollowLimits, state: State, options: Options, goal: Goal) -> int:
    """Follow a goal that begins now, or why not: then all goes on as before."""
    begin, end = room(3), room(3)
    gone = max(-goal.begins, 0.0)
    result = int(FollowCode.ACTIVE)
    first, after = 0, goal.count - 1
    while first < after:  # the first waypoint later than now
        middle = (first + after) // 2
        if goal.points[middle].time > gone:
            after = middle
        else:
            first = middle + 1
    time = goal.points[first].time - gone
    if time <= 0.0:  # it was in time when it was checked
        result = FollowCode.OLD_HEADER_TIMESTAMP
    for j in range(own.joints):
        if goal.moves[j] != 0 and result == FollowCode.ACTIVE:
            column(state.now, j, begin)
            at_point(goal.points[first], j, end)
            if spent_after(own, j, begin, end, time, goal.points[first].order, state.spent[j]) < 0.0:
                result = FollowCode.INVALID_GOAL
            if own.limited and options.limited != 0 and begins_quickly(own, goal, first, j, begin, time) != 0:
                result = FollowCode.INVALID_GOAL
    if result == FollowCode.ACTIVE:
        follow(own, state, options, goal, first, time)
    return result


def is_tolerance(value: float) -> int:
    """Whether it is a tolerance: from 0 on, or -1."""
    return 1 if math.isfinite(value) and (value >= 0.0 or -1.0 <= value <= -1.0) else 0


def can_be(own: FollowLimits, goal: Goal, i: int, spent: Joints) -> int:
    """Whether waypoint i can be, behind the one before it."""
    point, before = goal.points[i], goal.points[max(i - 1, 0)]
    begin, end = room(3), room(3)
    time = point.time - before.time if i > 0 else point.time
    wrong = 0
    if not (math.isfinite(point.time) and time >= (own.period / float(PASSED) if i > 0 else 0.0)):
        wrong = 1
    if not 1 <= point.order <= 3:
        wrong = 1
    for j in range(own.joints):
        if goal.moves[j] != 0:
            at_point(point, j, end)
            if not own.low[j] <= end[0] <= own.high[j]:
                wrong = 1
            if (point.order >= 2 and not math.isfinite(end[1])) or (
                point.order >= 3 and not math.isfinite(end[2])
            ):
                wrong = 1
            if i > 0 and wrong == 0:
                at_point(before, j, begin)
                spent[j] = spent_after(own, j, begin, end, time, min(point.order, before.order), spent[j])
                wrong = 1 if spent[j] < 0.0 else 0
    return 1 if wrong == 0 else 0


def check(own: FollowLimits, options: Options, goal: Goal) -> int:
    """Whether a goal may be followed, wherever the arm is; or why not."""
    spent = zeros(own.joints)
    result = int(FollowCode.SUCCESSFUL)
    moving, wrong = 0, 1 - is_tolerance(goal.goal_time)
    for j in range(own.joints):
        moving += 1 if goal.moves[j] != 0 else 0
        wrong += 2 - is_tolerance(goal.path.position[j]) - is_tolerance(goal.path.velocity[j])
        wrong += 2 - is_tolerance(goal.goal.position[j]) - is_tolerance(goal.goal.velocity[j])
    if moving == 0 or (moving < own.joints and options.partial == 0):
        result = FollowCode.INVALID_JOINTS
    elif wrong > 0 or goal.count < 1 or not goal.points or not math.isfinite(goal.begins):
        result = FollowCode.INVALID_GOAL
    else:
        last = goal.points[goal.count - 1]
        for i in range(goal.count):
            if result == FollowCode.SUCCESSFUL and can_be(own, goal, i, spent) == 0:
                result = FollowCode.INVALID_GOAL
        for j in range(own.joints):
            if goal.moves[j] != 0 and last.order >= 2 and abs(last.velocity[j]) > RESTING:
                result = FollowCode.INVALID_GOAL
        if result == FollowCode.SUCCESSFUL:
            if not last.time > 0.0:
                result = FollowCode.INVALID_GOAL
            elif goal.begins + last.time <= 0.0:
                result = FollowCode.OLD_HEADER_TIMESTAMP
            elif own.limited and options.limited != 0 and is_quick(own, options, goal) != 0:
                result = FollowCode.INVALID_GOAL
    return result


def start(own: FollowLimits, state: State, options: Options, goal: Goal) -> int:
    """Follow a checked goal, now or, where it begins later, until then the one before it, but for the delay."""
    ahead = (goal.begins - own.delay) / own.period - 0.5
    result = int(FollowCode.ACTIVE)
    state.ended = 0
    if ahead > 0.0:
        drop(state, FollowCode.INVALID_GOAL, FollowReason.REPLACED)
        state.next = goal
        state.has_next = 1
        state.wait = MOST_COUNTED
        if ahead < float(MOST_COUNTED):
            state.wait = int(ahead) + 1
    else:
        result = take(own, state, options, goal)
    return result


def cancel_goal(own: FollowLimits, state: State, options: Options, number: Long) -> None:
    """Cancel the goal of a number, or with 0 every one: come to rest, unless it waits. A stop goes on as it is."""
    is_followed = 1 if state.active != 0 and state.goal.number == number else 0
    state.ended = 0
    if number > 0 and state.has_next != 0 and state.next.number == number:
        drop(state, FollowCode.SUCCESSFUL, FollowReason.CANCELLED)
    elif number == 0 or is_followed != 0:
        if state.active != 0:
            tell(state, state.goal.number, FollowCode.SUCCESSFUL, FollowReason.CANCELLED)
        if number == 0:
            drop(state, FollowCode.SUCCESSFUL, FollowReason.CANCELLED)
        drop(state, FollowCode.INVALID_GOAL, FollowReason.DROPPED)
        if state.stops == 0:
            stop(own, state, options)


def stand_at(own: FollowLimits, state: State, q: Joints) -> int:
    """Rest at link positions, without a goal; 0 where one is no number."""
    finite = 1
    for j in range(own.joints):
        place = q[j]
        if not math.isfinite(place):
            finite, place = 0, 0.0
        for i in range(own.samples):
            state.path[i][j] = place
        for i in range(own.latency + 1):
            state.before[i][0][j] = place
        state.motion[1][0][j] = place
        state.now[0][j] = place
        state.begun[0][j] = place
    state.part = 1.0
    state.stop_time = own.stop_time
    state.age = own.stop_time  # at rest
    state.stops = 1
    return finite


# Samples -----------------------------------------------------------------------------------------------
def sample(
    own: FollowLimits, state: State, options: Options, input: Input, motion: Motion, output: Output
) -> None:
    """The motion of the next sample, and where the links are to be now."""
    rate, power = share(input.path_rate), 1.0
    state.ended = 0
    state.refused = FollowCode.ACTIVE
    if state.has_next != 0:
        state.wait -= 1
        if state.wait <= 0:
            state.has_next = 0
            state.refused = take(own, state, options, state.next)
            if state.refused != FollowCode.ACTIVE:
                tell(state, state.next.number, state.refused, FollowReason.BY_CODE)
    if state.contested > 0:
        state.calm += 1
        state.contested = counted(state.contested)
        if float(state.calm) * own.period > CALM:
            state.contested = 0
    state.part += rate
    if state.part > 1.0:
        state.part -= 1.0
        push(own, state, share(input.speed))
    for k in range(5):
        for j in range(own.joints):
            now = state.motion[0][k][j]
            motion[k][j] = power * (now + state.part * (state.motion[1][k][j] - now))
        power *= rate
    for j in range(own.joints):
        for k in range(2):
            for i in range(own.latency, 0, -1):
                state.before[i][k][j] = state.before[i - 1][k][j]
            state.before[0][k][j] = motion[k][j]
        output.position[j] = state.before[own.latency][0][j]
        output.velocity[j] = state.before[own.latency][1][j]


def is_within(own: FollowLimits, found: Joints, wanted: Joints, stated: Joints, usual: Joints) -> int:
    """Whether differences are allowed; one that is no number is not, where 0 does not allow all."""
    within = 1
    for j in range(own.joints):
        most = stated[j] if stated[j] > 0.0 else 0.0 if stated[j] < 0.0 else usual[j]
        if most > 0.0 and not abs(found[j] - wanted[j]) <= most:
            within = 0
    return within


def judge(own: FollowLimits, state: State, options: Options, input: Input, output: Output) -> int:
    """What is said of a sample: whether the goal is followed, or how it ended."""
    result, reason = int(FollowCode.ACTIVE), int(FollowReason.BY_CODE)
    goal = state.goal
    if state.refused != FollowCode.ACTIVE:
        result = state.refused
    elif state.active == 0:
        result = FollowCode.IDLE
    elif rests(state) == 0:
        near = is_within(own, input.position, output.position, goal.path.position, options.path.position)
        calm = is_within(own, input.velocity, output.velocity, goal.path.velocity, options.path.velocity)
        if share(input.path_rate) <= 0.0:
            reason = FollowReason.BRAKED
        if near == 0 or calm == 0 or reason == FollowReason.BRAKED:
            result = FollowCode.PATH_TOLERANCE_VIOLATED
            tell(state, goal.number, result, reason)
            drop(state, result, FollowReason.DROPPED)
            stop(own, state, options)
    else:
        near = is_within(own, input.position, output.position, goal.goal.position, options.goal.position)
        calm = is_within(own, input.velocity, output.velocity, goal.goal.velocity, options.goal.velocity)
        late = float(state.late) * own.period
        most = goal.goal_time if goal.goal_time > 0.0 else 0.0 if goal.goal_time < 0.0 else options.goal_time
        state.late = counted(state.late)
        if near != 0 and calm != 0:
            result = FollowCode.SUCCESSFUL
        elif (most > 0.0 and late > most) or (options.timeout > 0.0 and late > options.timeout):
            result = FollowCode.GOAL_TOLERANCE_VIOLATED
        if result != FollowCode.ACTIVE:
            state.active = 0
            tell(state, goal.number, result, reason)
    output.result = result
    output.waits = state.has_next
    output.contested = 1 if float(state.contested) * own.period > QUARREL else 0
    return result


# What each language has its own of: sums of products, and the robot's inverse dynamics ---------------------
def smooth(
    own: FollowLimits, path: Annotated[np.ndarray, "SAMPLES", "JOINTS"], newest: int, motion: Motion
) -> None:
    """Position and four derivatives of the smoothed path, at its newest sample."""
    motion[:] = own.smoothed(path, newest).tolist()


def commanded(own: FollowLimits, motion: Motion, inputs: Joints) -> None:
    """Inputs of the drives on a motion."""
    inputs[:] = own.inputs(motion).tolist()
