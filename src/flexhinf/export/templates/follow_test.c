{% macro finite(x) %}@{"-" if x == -infinity}{% if x in (infinity, -infinity) %}(@{name}_real)INFINITY{% else %}@{number(x)}{% endif %}{% endmacro %}
{% macro listed(values) %}{ {%- for x in values %}@{finite(x)}@{", " if not loop.last}{% endfor -%} }{% endmacro %}
{% macro pair(values) %}{@{listed(values[0])}, @{listed(values[1])}}{% endmacro %}
/* Test of @{name}_follow: goals and events with what Follower of flexhinf @{version} answers to them.
 * Exit code 0 if every answer is the same: rows, places, codes, and what is refused. */
#include "@{name}_follow.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>

typedef @{name}_real real;

enum { JOINTS = @{NAME}_FOLLOW_JOINTS, STEPS = @{steps}, EVERY = @{every}, COLUMNS = @{NAME}_COMMANDS + (2 * JOINTS) };

typedef struct {
    int first, count, moves[JOINTS];
    real begins;
    @{name}_follow_tolerance path, goal;
    real goal_time;
} goal_row;

/* Before a step: nothing, a goal, a cancel, or another pose; and what holds from it on: speed, path rate, and how far
 * what is measured is from where the links were to be. */
enum { NOTHING, GOAL, CANCEL, POSE };
typedef struct {
    int step, kind, goal, answer;
    real rates[2], away[2][JOINTS], pose[JOINTS];
} event_row;

static const @{name}_follow_options usual = {
    @{pair(usual[0])}, @{pair(usual[1])}, @{number(goal_time)}, @{number(timeout)}, @{number(stop_time)}, @{partial}@{", 1" if limited}
};
static const @{name}_follow_options options = {
    @{pair(options.usual[0])}, @{pair(options.usual[1])}, @{number(options.goal_time)}, @{number(options.timeout)},
    @{number(options.stop_time)}, @{options.partial | int}@{", 0" if limited}
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
    {@{one.step}, @{one.kind}, @{one.goal}, @{one.answer}, @{listed(one.rates)}, @{pair(one.away)}, @{listed(one.pose)}}@{"," if not loop.last}
{% endfor %}
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

/* What no row may exceed: jumps, and twists of springs; 0 is any. */
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
    expect(same(own->stop_time, usual.stop_time) && own->partial == usual.partial);
    plain.partial = 0;
{% if limited %}
    expect(own->limited == 1);
    plain.limited = 1;
{% endif %}
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
    expect(same(state.age, state.stop_time) && same(state.stop_time, @{name}_follow_defaults.stop_time));
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
            way[1].velocity[j] = 0;
            goal.path.position[j] = -1; /* any difference */
        }
        goal.points = way;
        goal.count = 2;
        begin(home);
        input.speed = 1;
        input.path_rate = 1;
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
    for (int k = -12; k <= 13; ++k) { /* every quarter of some turns, and far away */
        for (int j = 0; j < JOINTS; ++j) {
            pose[j] = (k == 13) ? @{far} : (real)k * (@{number(0.9)} + (@{number(0.1)} * (real)j));
        }
        begin(pose);
        input.speed = 1;
        input.path_rate = 1;
        expect(@{name}_follow_step(&state, &options, &@{name}_defaults, &input, &output) == @{NAME}_FOLLOW_IDLE);
        expect(@{name}_rest(&@{name}_defaults, pose, rest) == @{NAME}_OK);
        for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
            expect(fabs@{f}(output.r[i] - rest[i]) <= @{number(close)} * (1 + fabs@{f}(rest[i])));
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
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        const real whole = r[i];
        r[i] = (real)NAN;
        expect(taken(before, r) == 0);
        r[i] = whole;
    }
}

static void happen(const event_row *event)
{
    if (event->kind == GOAL) {
        const @{name}_follow_goal goal = goal_of(event->goal);
        int code = @{name}_follow_check(&options, &goal);
        if (code == @{NAME}_FOLLOW_SUCCESSFUL) {
            code = @{name}_follow_start(&state, &options, &goal);
        }
        expect(code == event->answer);
    } else if (event->kind == CANCEL) {
        @{name}_follow_cancel(&state, &options);
        expect(state.segment == 0 && state.goal.count == 0 && state.goal.points == NULL);
        expect(state.active == 0 && state.has_next == 0);
    } else if (event->kind == POSE) {
        begin(event->pose);
    } else {
        /* rates and errors alone */
    }
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
    rows();
    begin(home);
    for (int step = 0; step < STEPS; ++step) {
        int code;
        for (; event < @{events | length} && events[event].step <= step; ++event) {
            now = &events[event];
            happen(now);
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
        compare(step);
    }
    passed = (wrong == 0) ? 1 : 0;
    printf("@{name}_follow: %d samples, largest relative error %.3g (allowed %.3g), wrong answers %d: %s\n", STEPS,
           (double)worst, @{close}, wrong, (passed != 0) ? "passed" : "FAILED");
    return (passed != 0) ? 0 : 1;
}
