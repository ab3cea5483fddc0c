/* @{name}_follow: see @{name}_follow.h. Made by flexhinf @{version}; not to be edited. SPDX-License-Identifier: 0BSD */
#include "@{name}_follow.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

@{arithmetic}

#define FMA(a, b, c) (((a) * (b)) + (c))
#define JOINTS @{NAME}_FOLLOW_JOINTS
#define SAMPLES @{NAME}_FOLLOW_SAMPLES
#define SMOOTHING @{number(smoothing)}

#define scalar @{name}_real

const @{name}_follow_options @{name}_follow_defaults = {
    {{@{row(usual[0, 0])}}, {@{row(usual[0, 1])}}},
    {{@{row(usual[1, 0])}}, {@{row(usual[1, 1])}}},
    @{number(goal_time)},
    @{number(timeout)},
    @{number(stop_time)},
    @{partial}@{", 1" if limited}
};

/* Ranges of the joints, mean speeds and jumps that are not refused; and what the largest inputs twist springs by. */
static const scalar @{name}_follow_low[JOINTS] = {@{bounds(ranges[0])}};
static const scalar @{name}_follow_high[JOINTS] = {@{bounds(ranges[1])}};
static const scalar @{name}_follow_fastest[JOINTS] = {@{bounds(speeds)}};
static const scalar @{name}_follow_farthest[JOINTS] = {@{bounds(jumps)}};
static const scalar @{name}_follow_twists[JOINTS] = {@{bounds(twists)}};
{% if limited %}
/* What the drives leave to a goal: rates and accelerations of commands; velocities and accelerations on the way to its
 * first waypoint. */
static const scalar @{name}_follow_rates[JOINTS] = {@{bounds(allowed.commands[0])}};
static const scalar @{name}_follow_changes[JOINTS] = {@{bounds(allowed.commands[1])}};
static const scalar @{name}_follow_quickest[JOINTS] = {@{bounds(allowed.links[0])}};
static const scalar @{name}_follow_hardest[JOINTS] = {@{bounds(allowed.links[1])}};

/* The rates and accelerations that a path asks for where it is bent by a unit velocity. */
static const scalar @{name}_follow_bent_rates[JOINTS] = {@{bounds(allowed.bends[0])}};
static const scalar @{name}_follow_bent_changes[JOINTS] = {@{bounds(allowed.bends[1])}};
{% endif %}
static const int @{name}_follow_motors[JOINTS] = {@{motors | join(", ")}}; /* places in a row */

/* Weights of the samples before the newest one, from it back, for the position and four derivatives. */
static const scalar @{name}_follow_weights[SAMPLES - 1][5] = {
@{matrix(weights.T[1:])}
};

@{functions}
static scalar @{name}_follow_share(scalar value)
{
    scalar result = @{zero};
    if (isfinite(value) != 0 && value > @{zero}) {
        result = (value < @{unity}) ? value : @{unity};
    }
    return result;
}

/* On the polynomial between two waypoints, at seconds from the first: linear, cubic or quintic. */
static void @{name}_follow_between(const scalar begin[3], const scalar end[3], scalar time, scalar at, int order, scalar result[3])
{
    const scalar s = at / time, way = end[0] - begin[0];
    const scalar v0 = time * begin[1], v1 = time * end[1], a0 = time * time * begin[2], a1 = time * time * end[2];
    if (order == 1) {
        result[0] = begin[0] + (s * way);
        result[1] = way / time;
        result[2] = @{zero};
    } else {
        scalar c2 = (@{number(3.0)} * way) - ((@{number(2.0)} * v0) + v1);
        scalar c3 = (v0 + v1) - (@{number(2.0)} * way);
        scalar c4 = @{zero};
        scalar c5 = @{zero};
        if (order == 3) {
            c2 = @{number(0.5)} * a0;
            c3 = ((((@{number(10.0)} * way) - (@{number(6.0)} * v0)) - (@{number(4.0)} * v1)) - (@{number(1.5)} * a0)) +
                 (@{number(0.5)} * a1);
            c4 = ((((@{number(8.0)} * v0) + (@{number(7.0)} * v1)) + (@{number(1.5)} * a0)) - a1) - (@{number(15.0)} * way);
            c5 = ((((@{number(6.0)} * way) - (@{number(3.0)} * v0)) - (@{number(3.0)} * v1)) - (@{number(0.5)} * a0)) +
                 (@{number(0.5)} * a1);
        }
        result[0] = begin[0] + (s * (v0 + (s * (c2 + (s * (c3 + (s * (c4 + (s * c5)))))))));
        result[1] = (v0 + (s * ((@{number(2.0)} * c2) + (s * ((@{number(3.0)} * c3) +
                     (s * ((@{number(4.0)} * c4) + (s * (@{number(5.0)} * c5))))))))) / time;
        result[2] = ((@{number(2.0)} * c2) + (s * ((@{number(6.0)} * c3) + (s * ((@{number(12.0)} * c4) +
                     (s * (@{number(20.0)} * c5))))))) / (time * time);
    }
}

/* Joint j of a waypoint. */
static void @{name}_follow_at_point(const @{name}_follow_point *point, int j, scalar result[3])
{
    result[0] = point->position[j];
    result[1] = point->velocity[j];
    result[2] = point->acceleration[j];
}

{% if limited %}
/* Whether the way of joint j between two waypoints is quicker than its drive takes. */
static int @{name}_follow_hurries(int j, const scalar begin[3], const scalar end[3], scalar time, int order)
{
    int found = 0;
    for (int i = 0; i <= @{parts}; ++i) {
        scalar result[3];
        @{name}_follow_between(begin, end, time, (time * (scalar)i) / @{number(parts)}, order, result);
        found += (fabs@{f}(result[1]) > @{name}_follow_quickest[j] || fabs@{f}(result[2]) > @{name}_follow_hardest[j]) ? 1 : 0;
    }
    return found;
}

/* How the path goes from waypoint i to the next one. */
static int @{name}_follow_order_of(const @{name}_follow_goal *goal, int i)
{
    const int one = goal->points[i].order, next = goal->points[i + 1].order;
    return (one < next) ? one : next;
}

/* Velocity of joint j just behind waypoint i. */
static scalar @{name}_follow_behind(const @{name}_follow_goal *goal, int i, int j)
{
    const @{name}_follow_point *const point = &goal->points[i];
    scalar value = @{zero};
    if (i + 1 < goal->count) {
        const @{name}_follow_point *const next = &goal->points[i + 1];
        const scalar way = next->position[j] - point->position[j];
        value = (@{name}_follow_order_of(goal, i) > 1) ? point->velocity[j] : way / (next->time - point->time);
    }
    return value;
}

/* Whether joint j is quicker than its drive takes from the motion of now to waypoint i in a time, or there. */
static int @{name}_follow_begins_quickly(const @{name}_follow_state *state, const @{name}_follow_goal *goal, int i, int j, scalar time)
{
    const @{name}_follow_point *const point = &goal->points[i];
    const scalar begin[3] = {state->now[0][j], state->now[1][j], state->now[2][j]};
    scalar end[3];
    scalar first = @{zero};
    scalar last;
    int found;
    @{name}_follow_at_point(point, j, end);
    found = @{name}_follow_hurries(j, begin, end, time, point->order);
    last = end[1];
    if (point->order == 1) {
        last = (end[0] - begin[0]) / time;
        first = fabs@{f}(last - begin[1]);
    }
    last = fabs@{f}(@{name}_follow_behind(goal, i, j) - last);
    if (time < @{number(near)}) {
        first += last;
    }
    first = (first > last) ? first : last;
    if (point->order == 1 && (first * @{name}_follow_bent_rates[j] > @{name}_follow_rates[j] || first * @{name}_follow_bent_changes[j] > @{name}_follow_changes[j])) {
        found = 1;
    }
    return found;
}

{% endif %}
/* Duration of the stop, from this velocity and acceleration, that takes a way: T (v/2 + T a/12) = way. */
static scalar @{name}_follow_time_to(scalar way, scalar velocity, scalar acceleration)
{
    const scalar square = (@{number(0.25)} * velocity * velocity) + ((acceleration * way) / @{number(3.0)});
    const scalar root = (square > @{zero}) ? sqrt@{f}(square) : @{zero};
    const scalar divisor = ((way >= @{zero}) ? @{number(0.5)} * velocity : @{number(-0.5)} * velocity) + root;
    return (divisor > @{zero}) ? (@{number(2.0)} * fabs@{f}(way)) / divisor : @{zero};
}

/* Where joint j comes to rest from the motion at the beginning of the goal, age seconds later; sooner where its range
 * ends. */
static void @{name}_follow_stopping(const @{name}_follow_state *state, int j, scalar result[3])
{
    const scalar begin[3] = {state->from[0][j], state->from[1][j], state->from[2][j]};
    const scalar least = (@{name}_follow_low[j] < begin[0]) ? @{name}_follow_low[j] : begin[0];
    const scalar most = (@{name}_follow_high[j] > begin[0]) ? @{name}_follow_high[j] : begin[0];
    scalar end[3] = {@{zero}, @{zero}, @{zero}};
    scalar time = state->stop_time;
    end[0] = begin[0] + (time * ((@{number(0.5)} * begin[1]) + ((time * begin[2]) / @{number(12.0)})));
    if (end[0] < least || end[0] > most) {
        scalar sooner;
        end[0] = (end[0] < least) ? least : most;
        sooner = @{name}_follow_time_to(end[0] - begin[0], begin[1], begin[2]);
        sooner = (sooner > SMOOTHING) ? sooner : SMOOTHING;
        time = (sooner < time) ? sooner : time;
    }
    if (state->age >= time) {
        for (int k = 0; k < 3; ++k) {
            result[k] = end[k];
        }
    } else {
        @{name}_follow_between(begin, end, time, state->age, 3, result);
    }
}

/* From one waypoint to the next. */
static scalar @{name}_follow_length(const @{name}_follow_state *state)
{
    scalar time = state->first;
    if (time < @{zero}) {
        time = state->goal.points[state->segment].time - state->goal.points[state->segment - 1].time;
    }
    return time;
}

static int @{name}_follow_is_over(const @{name}_follow_state *state)
{
    return (state->segment == state->goal.count && state->age >= state->stopped_at) ? 1 : 0;
}

/* Whether the smoothed motion rests at the end too. */
static int @{name}_follow_rests(const @{name}_follow_state *state)
{
    return (@{name}_follow_is_over(state) != 0 && state->left == 0) ? 1 : 0;
}

/* The path so much later. */
static void @{name}_follow_advance(@{name}_follow_state *state, scalar time)
{
    scalar now[3][JOINTS];
    state->since += time;
    state->age = (state->age + time < state->stop_time) ? state->age + time : state->stop_time;
    while (state->segment < state->goal.count && state->since >= @{name}_follow_length(state)) {
        state->since -= @{name}_follow_length(state);
        state->segment += 1;
        state->first = @{number(-1.0)};
    }
    for (int j = 0; j < JOINTS; ++j) {
        scalar result[3] = {@{zero}, @{zero}, @{zero}};
        if (state->goal.moves[j] == 0) {
            @{name}_follow_stopping(state, j, result);
        } else if (state->segment == state->goal.count) {
            result[0] = state->goal.points[state->goal.count - 1].position[j];
        } else {
            const @{name}_follow_point *const next = &state->goal.points[state->segment];
            scalar begin[3] = {state->from[0][j], state->from[1][j], state->from[2][j]};
            scalar end[3];
            int order = next->order;
            @{name}_follow_at_point(next, j, end);
            if (state->first < @{zero}) {
                @{name}_follow_at_point(next - 1, j, begin);
                order = ((next - 1)->order < order) ? (next - 1)->order : order;
            }
            @{name}_follow_between(begin, end, @{name}_follow_length(state), state->since, order, result);
        }
        for (int k = 0; k < 3; ++k) {
            now[k][j] = result[k];
        }
    }
    for (int k = 0; k < 3; ++k) {
        for (int j = 0; j < JOINTS; ++j) {
            state->now[k][j] = now[k][j];
        }
    }
}

/* Whether the path has a velocity or an acceleration. */
static int @{name}_follow_moves(const @{name}_follow_state *state)
{
    int found = 0;
    for (int j = 0; j < JOINTS; ++j) {
        if (fabs@{f}(state->now[1][j]) + fabs@{f}(state->now[2][j]) > @{zero}) {
            found = 1;
        }
    }
    return found;
}

/* The next sample of the path, and the motion that the last ones give. */
static void @{name}_follow_push(@{name}_follow_state *state, scalar speed)
{
    const scalar most = @{NAME}_PERIOD / state->stop_time;
    scalar target = speed;
    if (@{name}_follow_moves(state) != 0) {
        if (state->goal.count == 0) { /* a stop is in true time */
            target = @{unity};
        } else if (target < state->speed - most) {
            target = state->speed - most;
        } else if (target > state->speed + most) {
            target = state->speed + most;
        } else {
            /* it is reached */
        }
    }
    state->speed = target;
    @{name}_follow_advance(state, @{NAME}_PERIOD * state->speed);
    state->newest = (state->newest + 1) % SAMPLES;
    for (int j = 0; j < JOINTS; ++j) {
        state->path[state->newest][j] = state->now[0][j];
    }
    for (int j = 0; j < JOINTS; ++j) {
        /* beside the newest sample, so that a path at rest leaves no rounding in the derivatives */
        const scalar newest = state->path[state->newest][j];
        scalar sums[5] = {@{zero}, @{zero}, @{zero}, @{zero}, @{zero}};
        int i = state->newest;
        for (int sample = 0; sample < SAMPLES - 1; ++sample) {
            scalar way;
            i = (i > 0) ? i - 1 : SAMPLES - 1;
            way = state->path[i][j] - newest;
            for (int k = 0; k < 5; ++k) {
                sums[k] += @{name}_follow_weights[sample][k] * way;
            }
        }
        sums[0] += newest;
        for (int k = 0; k < 5; ++k) {
            state->motion[0][k][j] = state->motion[1][k][j];
            state->motion[1][k][j] = sums[k];
        }
    }
    if (@{name}_follow_is_over(state) != 0 && state->left > 0) {
        state->left -= 1;
    }
}

static void @{name}_follow_begin_from_here(@{name}_follow_state *state, scalar stop_time)
{
    for (int k = 0; k < 3; ++k) {
        for (int j = 0; j < JOINTS; ++j) {
            state->from[k][j] = state->now[k][j];
        }
    }
    state->since = @{zero};
    state->age = @{zero};
    state->stop_time = stop_time;
    state->stopped_at = @{zero};
    for (int j = 0; j < JOINTS; ++j) {
        const scalar fast = fabs@{f}(state->now[1][j]) + fabs@{f}(state->now[2][j]);
        if (state->goal.moves[j] == 0 && fast > @{zero}) {
            state->stopped_at = stop_time;
        }
    }
    state->has_next = 0;
    state->left = SAMPLES;
    state->ended = 0;
}

/* Whether joint j would jump on this way, or be faster than it can. */
static int @{name}_follow_is_far(int j, scalar way, scalar time)
{
    const scalar size = fabs@{f}(way);
    return (size > @{name}_follow_farthest[j] && (time < SMOOTHING || size > @{name}_follow_fastest[j] * time)) ? 1 : 0;
}

/* From the motion that there is to waypoint i in a time. */
static void @{name}_follow_follow(@{name}_follow_state *state, scalar stop_time, const @{name}_follow_goal *goal, int i, scalar time)
{
    state->goal = *goal;
    state->segment = i;
    state->first = time;
    state->active = 1;
    @{name}_follow_begin_from_here(state, stop_time);
}

static int @{name}_follow_take(@{name}_follow_state *state, const @{name}_follow_options *options, const @{name}_follow_goal *goal)
{
    const scalar gone = (goal->begins < @{zero}) ? -goal->begins : @{zero};
    int result = @{NAME}_FOLLOW_ACTIVE;
    int first = 0;
    int after = goal->count - 1;
    scalar time;
    while (first < after) { /* the first waypoint later than now */
        const int middle = (first + after) / 2;
        if (goal->points[middle].time > gone) {
            after = middle;
        } else {
            first = middle + 1;
        }
    }
    time = goal->points[first].time - gone;
    if (time <= @{zero}) { /* it was in time when it was checked */
        result = @{NAME}_FOLLOW_OLD_HEADER_TIMESTAMP;
    }
    for (int j = 0; j < JOINTS; ++j) {
        if (goal->moves[j] != 0 && @{name}_follow_is_far(j, goal->points[first].position[j] - state->now[0][j], time) != 0) {
            result = @{NAME}_FOLLOW_INVALID_GOAL;
        }
{% if limited %}
        if (options->limited != 0 && goal->moves[j] != 0 && @{name}_follow_begins_quickly(state, goal, first, j, time) != 0) {
            result = @{NAME}_FOLLOW_INVALID_GOAL;
        }
{% endif %}
    }
    if (result == @{NAME}_FOLLOW_ACTIVE) {
        @{name}_follow_follow(state, options->stop_time, goal, first, time);
    }
    return result;
}

static int @{name}_follow_allowed(const scalar *error, const scalar *stated, const scalar *usual)
{
    for (int j = 0; j < JOINTS; ++j) {
        const scalar most = (stated[j] > @{zero}) ? stated[j] : ((stated[j] < @{zero}) ? @{zero} : usual[j]);
        if (most > @{zero} && !(error[j] <= most)) {
            return 0;
        }
    }
    return 1;
}

static int @{name}_follow_judge(@{name}_follow_state *state, const @{name}_follow_options *options, const @{name}_follow_input *input)
{
    const @{name}_follow_goal *const goal = &state->goal;
    const int is_last = @{name}_follow_rests(state);
    const @{name}_follow_tolerance *const stated = (is_last != 0) ? &goal->goal : &goal->path;
    const @{name}_follow_tolerance *const usual = (is_last != 0) ? &options->goal : &options->path;
    int result = @{NAME}_FOLLOW_ACTIVE;
    scalar error[2][JOINTS];
    int within = 0;
    for (int j = 0; j < JOINTS; ++j) {
        error[0][j] = fabs@{f}(input->position[j] - state->before[@{latency}][0][j]);
        error[1][j] = fabs@{f}(input->velocity[j] - state->before[@{latency}][1][j]);
    }
    if (@{name}_follow_allowed(error[0], stated->position, usual->position) != 0) {
        within = @{name}_follow_allowed(error[1], stated->velocity, usual->velocity);
    }
    if (state->active == 0) {
        result = @{NAME}_FOLLOW_IDLE;
    } else if (is_last == 0) {
        if (within == 0) {
            @{name}_follow_cancel(state, options);
            result = @{NAME}_FOLLOW_PATH_TOLERANCE_VIOLATED;
        }
    } else {
        const scalar late = (scalar)state->ended * @{NAME}_PERIOD;
        const scalar stated_time = goal->goal_time;
        const scalar most = (stated_time > @{zero}) ? stated_time : ((stated_time < @{zero}) ? @{zero} : options->goal_time);
        state->ended = (state->ended < @{most_counted}L) ? state->ended + 1 : state->ended;
        if (within != 0) {
            result = @{NAME}_FOLLOW_SUCCESSFUL;
        } else if ((most > @{zero} && late > most) || (options->timeout > @{zero} && late > options->timeout)) {
            result = @{NAME}_FOLLOW_GOAL_TOLERANCE_VIOLATED;
        } else {
            /* it may still be reached */
        }
        if (result != @{NAME}_FOLLOW_ACTIVE) {
            state->active = 0;
        }
    }
    return result;
}

int @{name}_follow_init(@{name}_follow_state *state, const @{name}_real *q)
{
    static const @{name}_follow_state none = {0};
    int code = (@{name}_follow_exact() != 0) ? @{NAME}_OK : @{NAME}_BAD_ARITHMETIC;
    *state = none;
    for (int j = 0; j < JOINTS; ++j) {
        const scalar place = (isfinite(q[j]) != 0) ? q[j] : @{zero};
        if (isfinite(q[j]) == 0) {
            code = @{NAME}_BAD_COMMAND;
        }
        for (int i = 0; i < SAMPLES; ++i) {
            state->path[i][j] = place;
        }
        for (int i = 0; i <= @{latency}; ++i) {
            state->before[i][0][j] = place;
        }
        state->motion[0][0][j] = place;
        state->motion[1][0][j] = place;
        state->now[0][j] = place;
        state->from[0][j] = place;
    }
    state->part = @{unity};
    state->speed = @{unity};
    state->stop_time = @{name}_follow_defaults.stop_time;
    state->age = state->stop_time; /* at rest */
    return code;
}

{% if limited %}
/* Whether drives do not take the commands from the first waypoint on, with the joints that are left out at home. */
static int @{name}_follow_is_quick(const @{name}_follow_options *options, const @{name}_follow_goal *goal)
{
    static const scalar home[JOINTS] = {@{row(home)}};
    const @{name}_follow_point *const points = goal->points;
    @{name}_follow_state state;
    scalar begin[3][JOINTS], command[JOINTS] = {0}, rate[JOINTS] = {0}, row[@{NAME}_STATES + @{NAME}_INPUTS];
    scalar time;
    int found = 0;
    long k = 0;
    if (goal->count < 2) {
        return 0;
    }
    if (points[goal->count - 1].time - points[0].time > @{number(most_judged)} * @{NAME}_PERIOD) {
        return 1;
    }
    time = points[1].time - points[0].time;
    for (int j = 0; j < JOINTS; ++j) {
        begin[0][j] = (goal->moves[j] != 0) ? points[0].position[j] : home[j];
        begin[1][j] = (goal->moves[j] != 0 && points[0].order > 1) ? points[0].velocity[j] : @{zero};
        begin[2][j] = (goal->moves[j] != 0 && points[0].order > 2) ? points[0].acceleration[j] : @{zero};
        if (goal->moves[j] != 0 && points[0].order == 1 && points[0].time > @{zero}) { /* it has that velocity already */
            begin[1][j] = @{name}_follow_behind(goal, 0, j);
        }
    }
    (void)@{name}_follow_init(&state, begin[0]);
    for (int j = 0; j < JOINTS; ++j) {
        for (int i = 0; i < SAMPLES; ++i) {
            const scalar age = @{NAME}_PERIOD * (scalar)i;
            state.path[(SAMPLES - i) % SAMPLES][j] = begin[0][j] - (age * (begin[1][j] - (@{number(0.5)} * age * begin[2][j])));
        }
        state.now[1][j] = begin[1][j];
        state.now[2][j] = begin[2][j];
    }
    @{name}_follow_follow(&state, options->stop_time, goal, 1, time);
    while (@{name}_follow_rests(&state) == 0) {
        @{name}_follow_push(&state, @{unity});
        @{called}(state.motion[1][0], state.motion[1][1], state.motion[1][2], state.motion[1][3], state.motion[1][4],
            @{name}_defaults.value, row, row + @{NAME}_STATES);
        for (int j = 0; j < JOINTS; ++j) {
            const scalar next = row[@{NAME}_STATES + j];
            const scalar changed = (next - command[j]) / @{NAME}_PERIOD;
            const scalar rounded = (@{number(rounding)} * fabs@{f}(next)) / @{NAME}_PERIOD;
            found += (k > 0 && fabs@{f}(changed) > @{name}_follow_rates[j] + rounded) ? 1 : 0;
            found += (k > 1 && fabs@{f}(changed - rate[j]) / @{NAME}_PERIOD > @{name}_follow_changes[j] + (rounded / @{NAME}_PERIOD)) ? 1 : 0;
            command[j] = next;
            rate[j] = changed;
        }
        k += 1;
    }
    return (found > 0) ? 1 : 0;
}

{% endif %}
static int @{name}_follow_is_tolerance(scalar value)
{
    return (isfinite(value) != 0 && (value >= @{zero} || (value >= @{number(-1.0)} && value <= @{number(-1.0)}))) ? 1 : 0;
}

/* Whether a waypoint can be, behind the one before it (NULL: it is the first). */
static int @{name}_follow_can_be(const @{name}_follow_goal *goal, const @{name}_follow_point *point, const @{name}_follow_point *before)
{
    const scalar time = (before != NULL) ? point->time - before->time : point->time;
    const scalar shortest = (before != NULL) ? @{NAME}_PERIOD / @{number(passed)} : @{zero};
    int wrong = 0;
    wrong += (isfinite(point->time) != 0 && time >= shortest) ? 0 : 1;
    wrong += (point->order >= 1 && point->order <= 3) ? 0 : 1;
    for (int j = 0; j < JOINTS; ++j) {
        if (goal->moves[j] != 0) {
            const scalar q = point->position[j];
            wrong += (isfinite(q) != 0 && q >= @{name}_follow_low[j] && q <= @{name}_follow_high[j]) ? 0 : 1;
            wrong += (point->order >= 2 && isfinite(point->velocity[j]) == 0) ? 1 : 0;
            wrong += (point->order >= 3 && isfinite(point->acceleration[j]) == 0) ? 1 : 0;
            wrong += (before != NULL && @{name}_follow_is_far(j, q - before->position[j], time) != 0) ? 1 : 0;
        }
    }
    return (wrong == 0) ? 1 : 0;
}

int @{name}_follow_check(const @{name}_follow_options *options, const @{name}_follow_goal *goal)
{
    int result = @{NAME}_FOLLOW_SUCCESSFUL;
    int moving = 0;
    for (int j = 0; j < JOINTS; ++j) {
        moving += (goal->moves[j] != 0) ? 1 : 0;
        if (@{name}_follow_is_tolerance(goal->path.position[j]) == 0 || @{name}_follow_is_tolerance(goal->path.velocity[j]) == 0 ||
            @{name}_follow_is_tolerance(goal->goal.position[j]) == 0 || @{name}_follow_is_tolerance(goal->goal.velocity[j]) == 0) {
            result = @{NAME}_FOLLOW_INVALID_GOAL;
        }
    }
    if (moving == 0 || (moving < JOINTS && options->partial == 0)) {
        result = @{NAME}_FOLLOW_INVALID_JOINTS;
    } else if (goal->count < 1 || goal->points == NULL || isfinite(goal->begins) == 0 || @{name}_follow_is_tolerance(goal->goal_time) == 0) {
        result = @{NAME}_FOLLOW_INVALID_GOAL;
    } else {
        const @{name}_follow_point *const last = &goal->points[goal->count - 1];
        for (int i = 0; i < goal->count; ++i) {
            if (@{name}_follow_can_be(goal, &goal->points[i], (i > 0) ? &goal->points[i - 1] : NULL) == 0) {
                result = @{NAME}_FOLLOW_INVALID_GOAL;
            }
        }
        for (int j = 0; j < JOINTS; ++j) {
            if (goal->moves[j] != 0 && last->order >= 2 && fabs@{f}(last->velocity[j]) > @{number(resting)}) {
                result = @{NAME}_FOLLOW_INVALID_GOAL;
            }
        }
        if (result == @{NAME}_FOLLOW_SUCCESSFUL) {
            if (!(last->time > @{zero})) {
                result = @{NAME}_FOLLOW_INVALID_GOAL;
            } else if (goal->begins + last->time <= @{zero}) {
                result = @{NAME}_FOLLOW_OLD_HEADER_TIMESTAMP;
{% if limited %}
            } else if (options->limited != 0 && @{name}_follow_is_quick(options, goal) != 0) {
                result = @{NAME}_FOLLOW_INVALID_GOAL;
{% endif %}
            } else {
                /* it may be followed */
            }
        }
    }
    return result;
}

int @{name}_follow_start(@{name}_follow_state *state, const @{name}_follow_options *options,
                        const @{name}_follow_goal *goal)
{
    const scalar samples = ceil@{f}(((goal->begins - @{number(delay_exact)}) / @{NAME}_PERIOD) - @{number(0.5)});
    int result = @{NAME}_FOLLOW_ACTIVE;
    if (samples >= @{unity}) {
        state->next = *goal;
        state->wait = (samples < @{number(most_counted)}) ? (long)samples : @{most_counted}L;
        state->has_next = 1;
    } else {
        result = @{name}_follow_take(state, options, goal);
    }
    return result;
}

void @{name}_follow_cancel(@{name}_follow_state *state, const @{name}_follow_options *options)
{
    state->has_next = 0;
    if (state->goal.count > 0) { /* else it rests, or its stop has begun */
        const scalar speed = state->speed;
        for (int j = 0; j < JOINTS; ++j) {
            state->goal.moves[j] = 0;
            state->now[1][j] *= speed; /* in true time, which a speed of 0 does not hold up */
            state->now[2][j] *= speed * speed;
        }
        state->goal.points = NULL;
        state->goal.count = 0;
        state->segment = 0;
        state->active = 0;
        state->speed = @{unity};
        @{name}_follow_begin_from_here(state, options->stop_time);
    }
}

int @{name}_follow_step(@{name}_follow_state *state, const @{name}_follow_options *options, const @{name}_param *param,
                       const @{name}_follow_input *input, @{name}_follow_output *output)
{
    const scalar rate = @{name}_follow_share(input->path_rate);
    scalar motion[5][JOINTS];
    scalar power = @{unity};
    int refused = @{NAME}_FOLLOW_ACTIVE;
    if (state->has_next != 0) {
        state->wait -= 1;
        if (state->wait <= 0) {
            const @{name}_follow_goal next = state->next;
            state->has_next = 0;
            refused = @{name}_follow_take(state, options, &next);
        }
    }
    state->part += rate;
    if (state->part > @{unity}) {
        state->part -= @{unity};
        @{name}_follow_push(state, @{name}_follow_share(input->speed));
    }
    for (int k = 0; k < 5; ++k) {
        for (int j = 0; j < JOINTS; ++j) {
            const scalar now = state->motion[0][k][j];
            motion[k][j] = power * (now + (state->part * (state->motion[1][k][j] - now)));
        }
        power *= rate;
    }
    for (int i = @{latency}; i > 0; --i) {
        for (int j = 0; j < JOINTS; ++j) {
            state->before[i][0][j] = state->before[i - 1][0][j];
            state->before[i][1][j] = state->before[i - 1][1][j];
        }
    }
    for (int j = 0; j < JOINTS; ++j) {
        state->before[0][0][j] = motion[0][j];
        state->before[0][1][j] = motion[1][j];
        output->position[j] = state->before[@{latency}][0][j];
        output->velocity[j] = state->before[@{latency}][1][j];
    }
    @{called}(motion[0], motion[1], motion[2], motion[3], motion[4], param->value, output->r, output->r + @{NAME}_STATES);
    output->result = (refused == @{NAME}_FOLLOW_ACTIVE) ? @{name}_follow_judge(state, options, input) : refused;
    output->waits = state->has_next; /* after a path that was left, none does */
    return output->result;
}

int @{name}_follow_row(const @{name}_param *param, const @{name}_real *before, const @{name}_real *r)
{
    scalar rest[@{NAME}_STATES + @{NAME}_INPUTS];
    int code = @{name}_rest(param, r, rest);
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        if (isfinite(r[i]) == 0) {
            code = @{NAME}_BAD_COMMAND;
        }
    }
    for (int j = 0; j < JOINTS; ++j) {
        if (!(fabs@{f}(r[j] - before[j]) <= @{name}_follow_farthest[j]) || !(fabs@{f}(r[@{name}_follow_motors[j]] - rest[@{name}_follow_motors[j]]) <= @{name}_follow_twists[j])) {
            code = @{NAME}_BAD_COMMAND;
        }
    }
    return code;
}
