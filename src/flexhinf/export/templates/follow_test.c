{% macro finite(x) %}@{"-" if x == -infinity}{% if x in (infinity, -infinity) %}(@{name}_real)INFINITY{% else %}@{number(x)}{% endif %}{% endmacro %}
{% macro listed(values) %}{ {%- for x in values %}@{finite(x)}@{", " if not loop.last}{% endfor -%} }{% endmacro %}
{% macro pair(values) %}{@{listed(values[0])}, @{listed(values[1])}}{% endmacro %}
/* Test of @{name}_follow: goals and events with what Follower of flexhinf @{version} answers to them.
 * Exit code 0 if every answer is the same: rows, places, codes, and what is refused. */
#include "@{name}_follow.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

typedef @{name}_real real;

enum { JOINTS = @{NAME}_FOLLOW_JOINTS, STEPS = @{steps}, EVERY = @{every}, COLUMNS = @{NAME}_COMMANDS + (2 * JOINTS) };

typedef struct {
    int first, count, moves[JOINTS];
    real begins;
    @{name}_follow_tolerance path, goal;
    real goal_time;
} goal_row;

/* Before a step: nothing, a goal, a cancel, another pose, or the end of every goal; and what holds from it on: speed,
 * path rate, and how far what is measured is from where the links were to be. */
enum { NOTHING, GOAL, CANCEL, POSE, END };
typedef struct {
    int step, kind, goal, number, answer;
    real rates[2], away[2][JOINTS], pose[JOINTS];
} event_row;

static const @{name}_follow_options usual = {
    @{pair(usual[0])}, @{pair(usual[1])}, @{number(goal_time)}, @{number(timeout)}, @{number(stop_time)}, @{partial}, 1
};
static const @{name}_follow_options options = {
    @{pair(options.usual[0])}, @{pair(options.usual[1])}, @{number(options.goal_time)}, @{number(options.timeout)},
    @{number(options.stop_time)}, @{options.partial | int}, 0
};
static const @{name}_follow_point points[@{points | length}] = {
{% for time, q, dq, ddq, order in points %}
    {@{finite(time)}, @{listed(q)}, @{listed(dq)}, @{listed(ddq)}, @{order}}@{"," if not loop.last}
{% endfor %}
};
static const goal_row goals[@{goals | length}] = {
{% for one in goals %}
    {@{one.first}, @{one.count}, {@{one.moves | join(", ")}}, @{finite(one.begins)}, @{pair(one.tolerances[0])},
     @{pair(one.tolerances[1])}, @{finite(one.time)}}@{"," if not loop.last}
{% endfor %}
};

/* Goals with the answers to them: with these options, and with no tolerances and every joint. */
static const int checks[@{checks | length}][3] = {
@{integers(checks)}
};
static const event_row events[@{events | length}] = {
{% for one in events %}
    {@{one.step}, @{one.kind}, @{one.goal}, @{one.number}, @{one.answer}, @{listed(one.rates)}, @{pair(one.away)}, @{listed(one.pose)}}@{"," if not loop.last}
{% endfor %}
};

/* In which step, or before it, which goal ended with which code, and why. */
static const int ended[@{ended | length}][4] = {
@{integers(ended)}
};

/* From which step on a step returns what, and whether a goal waits. */
static const int says[@{says | length}][3] = {
@{integers(says)}
};

/* Of every EVERY-th step the row, places and velocities; and the largest of each column. */
static const real expected[(STEPS + EVERY - 1) / EVERY][COLUMNS] = {
@{matrix(kept)}
};
static const real sizes[COLUMNS] = {@{row(sizes)}};
static const real home[JOINTS] = {@{row(home)}};

/* What no row may exceed: ranges, 0 is any; speeds, jumps, and twists of springs, 0 is any. */
static const real ends[2][JOINTS] = {{@{row(lows)}}, {@{row(highs)}}};
static const real peaks[JOINTS] = {@{row(peaks)}};
static const real jumps[JOINTS] = {@{row(jumps)}};
static const real twists[JOINTS] = @{"{" | safe}{% for x in twists %}@{number(0.0 if x == infinity else x)}@{", " if not loop.last}{% endfor %}};
static const int motors[JOINTS] = {@{motors | join(", ")}};

static @{name}_follow_state state;
static @{name}_follow_input input;
static @{name}_follow_output output;
static real worst;
static int wrong;

static void expect(int holds)
{
    wrong += (holds != 0) ? 0 : 1;
}

static int same(real a, real b)
{
    return (a <= b && a >= b) ? 1 : 0;
}

static @{name}_follow_goal goal_of(int k)
{
    const goal_row *const from = &goals[k];
    @{name}_follow_goal goal = {0};
    goal.points = &points[from->first];
    goal.count = from->count;
    for (int j = 0; j < JOINTS; ++j) {
        goal.moves[j] = from->moves[j];
    }
    goal.begins = from->begins;
    goal.path = from->path;
    goal.goal = from->goal;
    goal.goal_time = from->goal_time;
    return goal;
}

/* The options of the design, a pose that is no number, and goals that are refused. */
static void refused(void)
{
    const @{name}_follow_options *const own = &@{name}_follow_defaults;
    @{name}_follow_options plain = options;
    @{name}_follow_goal goal = goal_of(0);
    @{name}_follow_point changed = points[0];
    real pose[JOINTS];
    for (int j = 0; j < JOINTS; ++j) {
        expect(same(own->path.position[j], usual.path.position[j]) && same(own->path.velocity[j], usual.path.velocity[j]));
        expect(same(own->goal.position[j], usual.goal.position[j]) && same(own->goal.velocity[j], usual.goal.velocity[j]));
        pose[j] = home[j];
    }
    expect(same(own->goal_time, usual.goal_time) && same(own->timeout, usual.timeout));
    expect(same(own->stop_time, usual.stop_time) && own->partial == usual.partial && own->limited == usual.limited);
    plain.partial = 0;
    plain.limited = 1;
    for (int k = 0; k < @{checks | length}; ++k) {
        const @{name}_follow_goal one = goal_of(checks[k][0]);
        expect(@{name}_follow_check(&options, &one) == checks[k][1]);
        expect(@{name}_follow_check(&plain, &one) == checks[k][2]);
    }
    goal.points = &changed;
    goal.count = 1;
    for (int order = 0; order <= 4; ++order) {
        changed.order = order;
        for (int j = 0; j < JOINTS; ++j) {
            changed.velocity[j] = 0;
        }
        expect(@{name}_follow_check(&options, &goal) ==
               ((order >= 1 && order <= 3) ? @{NAME}_FOLLOW_SUCCESSFUL : @{NAME}_FOLLOW_INVALID_GOAL));
    }
    goal.points = NULL;
    expect(@{name}_follow_check(&options, &goal) == @{NAME}_FOLLOW_INVALID_GOAL);
    pose[JOINTS - 1] = (real)NAN;
    expect(@{name}_follow_init(&state, pose) == @{NAME}_BAD_COMMAND);
    expect(same(state.now[0][JOINTS - 1], 0));
}

/* Places and velocities from which the next sample is told how far the links are away. */
static void begin(const real *pose)
{
    expect(@{name}_follow_init(&state, pose) == @{NAME}_OK);
    expect(state.stops == 1 && same(state.age, state.stop_time) && same(state.stop_time, @{name}_follow_defaults.stop_time));
    for (int j = 0; j < JOINTS; ++j) {
        output.position[j] = pose[j];
        output.velocity[j] = 0;
    }
}

/* Between waypoints of two orders the path is that of the lower one: each of these ends linearly. */
static void mixed(void)
{
    static const int orders[3][2] = {{1, 1}, {1, 3}, {3, 1}};
    real place = 0;
    for (int k = 0; k < 3; ++k) {
        @{name}_follow_point way[2];
        @{name}_follow_goal goal = goal_of(0);
        for (int i = 0; i < 2; ++i) {
            way[i] = points[i];
            way[i].order = orders[k][i];
        }
        way[1].time = way[0].time + ((real)(2 * @{NAME}_FOLLOW_SAMPLES) * @{NAME}_PERIOD);
        for (int j = 0; j < JOINTS; ++j) {
            way[0].velocity[j] = (way[0].order > 1) ? way[0].velocity[j] : (real)NAN; /* not stated: not read */
            way[0].acceleration[j] = (way[0].order > 2) ? way[0].acceleration[j] : (real)NAN;
            way[1].acceleration[j] = (way[1].order > 2) ? way[1].acceleration[j] : (real)NAN;
            way[1].velocity[j] = (way[1].order > 1) ? 0 : (real)NAN;
            goal.path.position[j] = -1; /* any difference */
        }
        goal.points = way;
        goal.count = 2;
        begin(home);
        input.speed = 1;
        input.path_rate = 1;
        expect(@{name}_follow_check(&options, &goal) == @{NAME}_FOLLOW_SUCCESSFUL);
        expect(@{name}_follow_start(&state, &options, &goal) == @{NAME}_FOLLOW_ACTIVE);
        for (int step = 0; ((real)step * @{NAME}_PERIOD) < way[1].time; ++step) {
            (void)@{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output);
        }
        expect(k == 0 || fabs@{f}(output.position[0] - place) <= @{number(close)} * fabs@{f}(place));
        place = output.position[0];
    }
}

/* Angles beyond those that are reduced quickly, a goal that is over when it begins, and one that waits for ages. */
static void far_away(void)
{
    real pose[JOINTS], rest[@{NAME}_COMMANDS];
    @{name}_follow_goal goal = goal_of(0);
    for (int k = -12; k <= 32; ++k) { /* every quarter of some turns, of many, and of more than are counted in float */
        for (int j = 0; j < JOINTS; ++j) {
            const real turns = (k < 13) ? (real)k : ((k < 24) ? @{number(797.0)} * (real)(k - 12) : @{far} * ((real)k / 26));
            pose[j] = turns * (@{number(0.9)} + (@{number(0.1)} * (real)j));
        }
        begin(pose);
        input.speed = 1;
        input.path_rate = 1;
        expect(@{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output) == @{NAME}_FOLLOW_IDLE);
        expect(@{name}_rest(&@{name}_defaults, pose, rest) == @{NAME}_OK);
        for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
            expect(fabs@{f}(output.r[i] - rest[i]) <= (64 * @{number(precision.eps)}) * (1 + fabs@{f}(rest[i])));
        }
    }
    begin(goal.points[goal.count - 1].position);
    goal.begins = -1 - goal.points[goal.count - 1].time;
    expect(@{name}_follow_start(&state, &options, &goal) == @{NAME}_FOLLOW_OLD_HEADER_TIMESTAMP);
    goal.begins = @{largest};
    expect(@{name}_follow_start(&state, &options, &goal) == @{NAME}_FOLLOW_ACTIVE);
    (void)@{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output);
    expect(output.waits == 1 && output.result == @{NAME}_FOLLOW_IDLE);
}

/* What is told of a jump of one sample: the B-spline of degree 5 at the age of that sample, and its derivatives, each as
 * exactly as truncated powers are summed. */
static void impulse(void)
{
    static const real choices[3] = {1, -6, 15};
    const int half = @{NAME}_FOLLOW_SAMPLES / 2;
    const real knot = @{number(smoothing_time)}, count = (real)half / 3, jump = @{number(0.5)} * jumps[JOINTS - 1];
    real pose[JOINTS] = {0};
    begin(pose);
    for (int step = 0; step <= @{NAME}_FOLLOW_SAMPLES; ++step) {
        const real near = (real)((step < half) ? step : (2 * half) - step) / count;
        real scale = jump / count, sign = 1;
        state.begun[0][JOINTS - 1] = (step == 0) ? jump : 0;
        (void)@{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output);
        for (int k = 0; k < 5; ++k) {
            real sum = 0, size = 0;
            for (int i = 0; i < 3 && near > (real)i; ++i) { /* the nearer half, mirrored */
                real power = choices[i] * scale;
                for (int m = 1; m <= 5 - k; ++m) {
                    power *= (near - (real)i) / (real)m;
                }
                sum += power;
                size += fabs@{f}(power);
            }
            sum *= (step < half) ? 1 : sign;
            expect(step == 0 || fabs@{f}(state.motion[1][k][JOINTS - 1] - sum) <= (1000 * @{number(precision.eps)}) * size);
            scale /= knot;
            sign = -sign;
        }
    }
}

static int taken(const real *before, const real *r)
{
    return (@{name}_follow_row(&@{name}_defaults, before, r) == @{NAME}_OK) ? 1 : 0;
}

/* A row that cannot be: a jump, a spring twisted too far, or what is no number. */
static void rows(void)
{
    real pose[JOINTS], before[@{NAME}_COMMANDS], r[@{NAME}_COMMANDS];
    for (int j = 0; j < JOINTS; ++j) {
        pose[j] = home[j];
    }
    expect(@{name}_rest(&@{name}_defaults, pose, before) == @{NAME}_OK && taken(before, before) != 0);
    for (int j = 0; j < JOINTS; ++j) {
        for (int sign = -1; sign <= 1; sign += 2) {
            for (int beyond = 0; beyond <= 1; ++beyond) {
                const real share = (real)sign * ((beyond != 0) ? @{number(1.02)} : @{number(0.98)});
                pose[j] = home[j] + (share * jumps[j]);
                expect(@{name}_rest(&@{name}_defaults, pose, r) == @{NAME}_OK && taken(before, r) != beyond);
                pose[j] = home[j];
                if (twists[j] > 0) {
                    expect(@{name}_rest(&@{name}_defaults, pose, r) == @{NAME}_OK);
                    r[motors[j]] += share * twists[j];
                    expect(taken(before, r) != beyond);
                }
            }
        }
    }
    expect(@{name}_rest(&@{name}_defaults, pose, r) == @{NAME}_OK);
    for (int j = 0; j < JOINTS; ++j) {
        for (int sign = -1; sign <= 1; sign += 2) {
            const real end = ends[(sign < 0) ? 0 : 1][j];
            r[JOINTS + j] = (real)sign * @{number(0.98)} * peaks[j];
            expect(taken(before, r) != 0);
            r[JOINTS + j] = (real)sign * @{number(1.02)} * peaks[j];
            expect(taken(before, r) != @{paced | int});
            r[JOINTS + j] = 0;
            if (end < 0 || end > 0) { /* out of the range, and back */
                real outside[@{NAME}_COMMANDS], edge[@{NAME}_COMMANDS];
                pose[j] = end;
                expect(@{name}_rest(&@{name}_defaults, pose, edge) == @{NAME}_OK);
                pose[j] = end + ((real)sign * @{number(0.2)} * jumps[j]);
                expect(@{name}_rest(&@{name}_defaults, pose, outside) == @{NAME}_OK);
                expect(taken(edge, edge) != 0 && taken(edge, outside) == 0);
                expect(taken(outside, outside) != 0 && taken(outside, edge) != 0);
                pose[j] = home[j];
            }
        }
    }
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        const real whole = r[i];
        r[i] = (real)NAN;
        expect(taken(before, r) == 0);
        r[i] = whole;
    }
}

/* Rows behind one another: to and fro by seven tenths of a jump, at once and later. */
static void streams(void)
{
    real pose[JOINTS], near[@{NAME}_COMMANDS], far[@{NAME}_COMMANDS], spent[JOINTS] = {0};
    const long later = (long)(@{number(smoothing_time)} / @{NAME}_PERIOD) + 1;
    for (int j = 0; j < JOINTS; ++j) {
        pose[j] = home[j];
    }
    expect(@{name}_rest(&@{name}_defaults, pose, near) == @{NAME}_OK);
    pose[JOINTS - 1] += @{number(0.7)} * jumps[JOINTS - 1];
    expect(@{name}_rest(&@{name}_defaults, pose, far) == @{NAME}_OK);
    expect(@{name}_follow_stream(&@{name}_defaults, spent, 1, near, far) == @{NAME}_OK);
{% if paced %}
    expect(@{name}_follow_stream(&@{name}_defaults, spent, 1, far, near) == @{NAME}_BAD_COMMAND);
    expect(spent[JOINTS - 1] > @{number(0.3)} * jumps[JOINTS - 1] && spent[JOINTS - 1] < @{number(0.7)} * jumps[JOINTS - 1]);
    expect(@{name}_follow_stream(&@{name}_defaults, spent, later, far, near) == @{NAME}_OK);
    expect(spent[JOINTS - 1] < @{number(0.3)} * jumps[JOINTS - 1]);
{% else %}
    expect(@{name}_follow_stream(&@{name}_defaults, spent, later, far, near) == @{NAME}_OK);
    expect(same(spent[0], 0) && same(spent[JOINTS - 1], 0));
{% endif %}
}

/* The joint that goals lead to and fro. */
static int led;

/* Steps of a goal to home and some jumps from there, with whether goals were contested in each; 0: no other goal. */
static void lead(real jumps_away, long steps, long *since)
{
    static @{name}_follow_point point;
    @{name}_follow_goal goal = {0};
    point.order = 1;
    point.time = @{number(20.0)};
    for (int j = 0; j < JOINTS; ++j) {
        point.position[j] = (j == led) ? home[j] + (jumps_away * jumps[j]) : (real)NAN;
        goal.moves[j] = (j == led) ? 1 : 0;
    }
    goal.points = &point;
    goal.count = 1;
    if (since[1] >= 0) {
        expect(@{name}_follow_start(&state, &options, &goal) == @{NAME}_FOLLOW_ACTIVE);
    }
    for (long step = 0; step < steps; ++step) {
        const real age = (real)since[0] * @{NAME}_PERIOD, calm = (real)labs(since[1]) * @{NAME}_PERIOD;
        for (int j = 0; j < JOINTS; ++j) {
            input.position[j] = output.position[j];
            input.velocity[j] = output.velocity[j];
        }
        (void)@{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output);
        if (fabs@{f}(age - 1) > 2 * @{NAME}_PERIOD && fabs@{f}(calm - @{number(0.5)}) > 2 * @{NAME}_PERIOD) {
            expect(output.contested == ((age > 1 && calm < @{number(0.5)}) ? 1 : 0));
        }
        since[0] += (since[0] > 0) ? 1 : 0;
        since[1] += (since[1] < 0) ? -1 : 1;
    }
}

/* Goals that lead to and fro are contested after a second, and no more half a second after the last one; goals that lead
 * on, or to and fro by less than a jump, are not, nor is one behind another. */
static void contest(void)
{
    const long every = (long)(@{number(0.15)} / @{NAME}_PERIOD) + 1;
    long since[2] = {0, 0}; /* samples since the first goal that led back, 0: none did; and since the last, below 0: none comes */
    begin(home);
    input.speed = 1;
    input.path_rate = 1;
    for (int k = 0; k < 10; ++k) {
        since[0] = (k == 2) ? 1 : since[0];
        since[1] = 0;
        lead((k % 2 == 0) ? @{number(1.2)} : 0, every, since);
    }
    since[1] = -every - 1;
    lead(0, 12 * every, since);
    since[0] = 0;
    since[1] = 0;
    for (int k = 0; k < 10; ++k) {
        lead((k % 2 == 0) ? @{number(0.9)} : 0, every, since);
    }
    for (int k = 0; k < 10; ++k) {
        lead(@{number(0.2)} * (real)k, every, since);
    }
    lead(@{number(0.3)}, 1, since); /* one that waits, without a number: both are over at a cancel */
    state.goal.number = 0;
    state.next = state.goal;
    state.has_next = 1;
    @{name}_follow_cancel(&state, &options);
    expect(state.stops == 1 && state.has_next == 0 && state.ended == 0);
    for (int k = 0; k < 10; ++k) { /* each is over before the next one comes */
        @{name}_follow_cancel(&state, &options);
        lead((k % 2 == 0) ? @{number(1.2)} : 0, every, since);
    }
}

/* Goals that ended in the last call, each when and as it should. */
static void tell(int step)
{
    static int told = 0;
    for (int i = 0; i < state.ended; ++i) {
        const int *const row = ended[told];
        expect(told < @{ended | length});
        if (told < @{ended | length}) {
            expect(row[0] == step && row[1] == (int)state.ends[i].number);
            expect(row[2] == state.ends[i].code && row[3] == state.ends[i].reason);
            told += 1;
        }
    }
    expect(step < STEPS - 1 || told == @{ended | length});
}

static void happen(const event_row *event, int step)
{
    if (event->kind == GOAL) {
        @{name}_follow_goal goal = goal_of(event->goal);
        int code = @{name}_follow_check(&options, &goal);
        goal.number = event->number;
        state.ended = 0;
        if (code == @{NAME}_FOLLOW_SUCCESSFUL) {
            code = @{name}_follow_start(&state, &options, &goal);
        }
        expect(code == event->answer);
    } else if (event->kind == CANCEL && event->number > 0) {
        @{name}_follow_cancel_goal(&state, &options, event->number);
    } else if (event->kind == CANCEL) {
        @{name}_follow_cancel(&state, &options);
        expect(state.stops == 1 && state.active == 0 && state.has_next == 0);
    } else if (event->kind == POSE) {
        begin(event->pose);
    } else if (event->kind == END) {
        @{name}_follow_end_all(&state, event->number, @{NAME}_FOLLOW_DROPPED);
        expect(state.active == 0 && state.has_next == 0);
    } else {
        state.ended = 0; /* rates and errors alone */
    }
    tell(step);
}

static void compare(int step)
{
    for (int i = 0; i < COLUMNS && step % EVERY == 0; ++i) {
        const int j = i - @{NAME}_COMMANDS;
        const real found = (j < 0) ? output.r[i] : ((j < JOINTS) ? output.position[j] : output.velocity[j - JOINTS]);
        const real error = fabs@{f}(found - expected[step / EVERY][i]) / sizes[i];
        expect(error <= @{number(close)});
        worst = (error > worst) ? error : worst;
    }
}

int main(void)
{
    const event_row *now = &events[0];
    int event = 0, said = 0, passed;
    refused();
    mixed();
    far_away();
    impulse();
    rows();
    streams();
    contest();
    led = JOINTS - 1;
    contest();
    begin(home);
    for (int step = 0; step < STEPS; ++step) {
        int code;
        for (; event < @{events | length} && events[event].step <= step; ++event) {
            now = &events[event];
            happen(now, step);
        }
        for (int j = 0; j < JOINTS; ++j) {
            input.position[j] = output.position[j] + now->away[0][j];
            input.velocity[j] = output.velocity[j] + now->away[1][j];
        }
        input.speed = now->rates[0];
        input.path_rate = now->rates[1];
        code = @{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output);
        said += (said + 1 < @{says | length} && says[said + 1][0] <= step) ? 1 : 0;
        expect(code == says[said][1] && output.result == code && output.waits == says[said][2]);
        tell(step);
        compare(step);
    }
    passed = (wrong == 0) ? 1 : 0;
    printf("@{name}_follow: %d samples, largest relative error %.3g (allowed %.3g), wrong answers %d: %s\n", STEPS,
           (double)worst, @{close}, wrong, (passed != 0) ? "passed" : "FAILED");
    return (passed != 0) ? 0 : 1;
}
