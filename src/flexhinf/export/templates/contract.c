/* The contract of @{name}, rehearsed: every value that a step returns is provoked, and what README.md says of it is
 * looked for. Made by flexhinf @{version}. Exit code 0 if all of it holds. */
#include "@{name}.h"

#include <fenv.h>
#include <math.h>
#include <stdio.h>

enum { PREDICTS = @{code.predicts | int}, STARTS_ANYWHERE = @{code.starts_anywhere | int} };

/* What a step returns for a measurement that is not finite, and for none. */
enum { NOT_FINITE = @{NAME}_@{"PREDICTED" if code.predicts else "BAD_MEASUREMENT"}, UNMEASURED = @{NAME}_@{"PREDICTED" if code.predicts else "STOPPED"} };

/* What is measured and commanded at first. */
static const @{name}_real first_y[@{NAME}_MEASUREMENTS] = {@{row(first_y)}};
static const @{name}_real first_r[@{code.sizes.r}] = {@{row(first_r)}};

/* Where @{name}_init believes the robot, if it believes anything. */
static const @{name}_real first_estimate[@{NAME}_STATES] = {@{row(first_estimate)}};

static @{name}_state state;
static @{name}_param param;
static @{name}_input input;
static @{name}_output output;
static int wrong;

static void expect(int holds, const char *what)
{
    if (!holds) {
        printf("@{name}: %s: FAILED\n", what);
        wrong += 1;
    }
}

/* What is given after the first sample was: it is measured, in time. */
static void give(void)
{
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = first_y[i];
    }
    for (int i = 0; i < @{code.sizes.r}; ++i) {
        input.r[i] = first_r[i];
    }
    input.age = 0;
    input.elapsed = 0;
    input.measured = 1;
}

/* One step. Whatever it returns, its output is finite, and within the narrower of the caller's limits and the design's. */
static int step(void)
{
    const int code = @{name}_step(&state, &param, &input, &output);
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        const @{name}_real u = output.u[i];
        const @{name}_real least = @{name}_defaults.value[@{NAME}_P_LOWER + i], most = @{name}_defaults.value[@{NAME}_P_UPPER + i];
        expect(isfinite(u), "an output that is finite");
        expect(u >= least && u <= most, "an output within the limits of the design");
        expect(u >= param.value[@{NAME}_P_LOWER + i] && u <= param.value[@{NAME}_P_UPPER + i], "an output within my limits");
    }
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        expect(isfinite(output.estimate[i]), "an estimate that is finite");
    }
    expect(output.path_rate >= 0 && output.path_rate <= 1, "a path rate from 0 to 1");
    return code;
}

/* Whether a step returns this, and applies what the step before did. */
static int holds(int expected)
{
    const @{name}_output before = output;
    int right = step() == expected;
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        right = right && output.u[i] >= before.u[i] && output.u[i] <= before.u[i];
    }
    return right;
}

/* Whether the memories to go back to are those of the start. */
static int from_start(void)
{
    int same = 1;
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        same = same && state.newer[i] >= state.start[i] && state.newer[i] <= state.start[i];
        same = same && state.older[i] >= state.start[i] && state.older[i] <= state.start[i];
    }
    return same;
}

/* A start forgets all that is counted, and all that was remembered. */
static void begun(void)
{
    expect(from_start(), "earlier memories that are those of the start");
    expect(state.missing == 0 && state.failed == 0 && state.began_again == 0 && state.samples == 0, "counts that begin");
    expect(state.slip >= 0 && state.slip <= 0 && state.waiting == 1 && state.refused == 0, "a start from nothing");
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        expect(state.unseen[i] == 0, "measurements that were seen");
    }
}

static void starts(void)
{
    expect(step() == @{NAME}_NOT_INITIALISED, "NOT_INITIALISED before init");
    expect(@{name}_init(&state) == @{NAME}_OK, "init returns OK: the flags of the compiler change no results");
    input.measured = 0;
    expect(step() == @{NAME}_WAITING && output.unseen[0] == 1, "WAITING before the first measurement");
    for (int i = 0; i < @{NAME}_STATES && STARTS_ANYWHERE; ++i) {
        expect(output.estimate[i] >= first_estimate[i] && output.estimate[i] <= first_estimate[i], "the first estimate");
    }
    give();
    if (@{NAME}_COMMANDS > 0) {
        input.r[0] = (@{name}_real)NAN;
        expect(step() == @{NAME}_WAITING, "WAITING with a bad command before the first measurement that is used");
        give();
    }
    expect(step() == @{NAME}_OK && output.unseen[0] == 0, "OK after a measurement");
    state.mark ^= 1u; /* as by an overwritten memory */
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        output.estimate[i] = 1;
    }
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        output.u[i] = (@{name}_real)NAN;
    }
    output.path_rate = 1;
    output.status = -1; /* what stands there is none of the next step */
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        output.unseen[i] = -1;
{% if code.rejected is not none %}
        output.rejected[i] = -1;
{% endif %}
    }
{% if code.doubt is not none %}
    output.doubtful = -1;
{% endif %}
    expect(step() == @{NAME}_NOT_INITIALISED, "NOT_INITIALISED after its mark was overwritten");
    expect(output.status == 0 && output.path_rate <= 0, "no status and no path without a start");
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        expect(output.estimate[i] >= 0 && output.estimate[i] <= 0, "no estimate without a start");
    }
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        expect(output.unseen[i] == 32767, "measurements that nobody looks at");
{% if code.rejected is not none %}
        expect(output.rejected[i] == 0, "nothing rejected without a start");
{% endif %}
    }
{% if code.doubt is not none %}
    expect(output.doubtful == 0, "nothing doubted without a start");
{% endif %}
    for (int k = 0; k < 2; ++k) {
        @{name}_real estimate[@{NAME}_STATES] = {0}, acting[@{NAME}_INPUTS] = {0};
        const int bad = (k == 1 || STARTS_ANYWHERE) ? @{NAME}_BAD_START : @{NAME}_OK; /* else no estimate is read */
        estimate[@{NAME}_STATES - 1] = (k == 0) ? (@{name}_real)NAN : 0;
        acting[@{NAME}_INPUTS - 1] = (k == 1) ? (@{name}_real)HUGE_VAL : 0;
        expect(@{name}_start(&state, &param, estimate, acting) == bad, "BAD_START for a start that is not finite");
        expect(step() == ((bad == @{NAME}_OK) ? @{NAME}_OK : @{NAME}_NOT_INITIALISED), "NOT_INITIALISED after BAD_START");
    }
    for (int i = 0; i < @{NAME}_STATES && STARTS_ANYWHERE; ++i) {
        @{name}_real estimate[@{NAME}_STATES] = {0};
        estimate[i] = (i % 2 == 0) ? (@{name}_real)NAN : (@{name}_real)HUGE_VAL;
        expect(@{name}_start(&state, &param, estimate, NULL) == @{NAME}_BAD_START, "BAD_START for each number");
    }
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    expect(step() == @{NAME}_OK, "OK after a start");
    state.missing = 3;
    state.failed = 1;
    state.began_again = 1;
    state.samples = 5;
    state.slip = 1;
    state.unseen[@{NAME}_MEASUREMENTS - 1] = 7;
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    begun();
    expect(step() == @{NAME}_OK, "OK after a start");
}

/* Whether this program rounds to nearest, in its own type. */
static int to_nearest(void)
{
    volatile @{name}_real one = 1, small = @{number(eps)} / 4;
    const @{name}_real above = one + small, below = one - small, minus = -one - small;
    return above <= 1 && below >= 1 && minus >= -1;
}

/* What a processor may be set to is found: other roundings, and on a PC the smallest numbers as 0. Where a way of
 * rounding changes nothing here, as of a type that is computed in software, nothing is to be found. */
static void arithmetic(void)
{
    static const int ways[] = {
#ifdef FE_UPWARD
        FE_UPWARD,
#endif
#ifdef FE_DOWNWARD
        FE_DOWNWARD,
#endif
#ifdef FE_TOWARDZERO
        FE_TOWARDZERO,
#endif
        -1};
    const int usual = fegetround();
    for (int k = 0; ways[k] != -1; ++k) {
        const int set = (fesetround(ways[k]) == 0) ? 1 : 0;
        const int other = (set != 0 && to_nearest() == 0) ? 1 : 0;
        const int code = @{name}_init(&state);
        (void)fesetround(usual);
        expect(code == ((other != 0) ? @{NAME}_BAD_ARITHMETIC : @{NAME}_OK), "another rounding is found");
    }
#if defined(__GNUC__) && defined(__SSE2__)
    {
        const unsigned before = __builtin_ia32_stmxcsr();
        int code;
        __builtin_ia32_ldmxcsr(before | 0x8000u);
        code = @{name}_init(&state);
        __builtin_ia32_ldmxcsr(before);
        expect(code == @{NAME}_BAD_ARITHMETIC, "smallest numbers that become 0 are found");
    }
#endif
    expect(@{name}_init(&state) == @{NAME}_OK, "init returns OK again");
}

/* A start that is finite and bad: the memory goes back to it once, and then to that of the design. */
static void bad_start(void)
{
    @{name}_real far[@{NAME}_STATES];
    int first = 0;
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        far[i] = @{largest};
    }
    (void)@{name}_start(&state, &param, far, NULL);
    give();
    for (int k = 1; k <= 20 && first == 0; ++k) {
        first = (step() == @{NAME}_OK) ? k : 0;
    }
    expect(first > 0 || !PREDICTS, "OK some samples after a bad start");
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    expect(step() == @{NAME}_OK, "OK after a start");
}

static void samples(void)
{
    if (@{NAME}_COMMANDS > 0) {
        for (int k = 0; k < 2; ++k) {
            input.r[@{NAME}_COMMANDS - 1] = (k == 0) ? (@{name}_real)NAN : -(@{name}_real)HUGE_VAL;
            expect(holds(@{NAME}_BAD_COMMAND), "BAD_COMMAND, and the last output held");
        }
        for (int k = 2; k < param.missing_limit; ++k) {
            give();
            input.r[(k - 2) % @{NAME}_COMMANDS] = (k % 2 == 0) ? (@{name}_real)NAN : (@{name}_real)HUGE_VAL;
            expect(holds(@{NAME}_BAD_COMMAND), "BAD_COMMAND again");
        }
        expect(holds((param.missing_limit > 0) ? @{NAME}_STOPPED : @{NAME}_BAD_COMMAND), "too many bad commands");
        give();
        expect(step() == @{NAME}_OK, "OK after a bad command");
        param.missing_limit = 1;
        input.r[0] = (@{name}_real)NAN;
        expect(holds(@{NAME}_BAD_COMMAND) && holds(@{NAME}_STOPPED), "as many bad commands as I say");
        param.missing_limit = @{name}_defaults.missing_limit;
        give();
        expect(step() == @{NAME}_OK, "OK after a bad command");
    }
    for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
            input.y[i] = (k == 0) ? (@{name}_real)NAN : (@{name}_real)HUGE_VAL;
        }
        expect(PREDICTS ? step() == NOT_FINITE : holds(NOT_FINITE), "a measurement that is not finite");
    }
    give();
    for (int k = 1; k < 4 && PREDICTS && @{NAME}_MEASUREMENTS > 1; ++k) {
        input.y[0] = (@{name}_real)NAN;
        expect(step() == @{NAME}_OK && output.unseen[0] == k + 2, "a count of samples without one of several measurements");
        expect(output.unseen[@{NAME}_MEASUREMENTS - 1] == 0, "no count of one that is there");
    }
    for (int k = 0; k < 3; ++k) {
        give();
        input.age = (k == 0) ? (@{name}_real)NAN : (k == 1) ? -param.oldest : 2 * param.oldest;
        expect(PREDICTS ? step() == UNMEASURED : holds(UNMEASURED), "an age that is none");
    }
    give();
    expect(step() == @{NAME}_OK, "OK again");
    input.measured = 0;
    for (int k = 0; k < param.missing_limit; ++k) {
        expect(step() == UNMEASURED, "PREDICTED without a measurement");
    }
    expect(holds(@{NAME}_STOPPED) && holds(@{NAME}_STOPPED), "STOPPED after too many, and the last output held");
    give();
    expect(step() == @{NAME}_OK, "OK after STOPPED: it does not latch");
}

/* The memory is overwritten by numbers that are not finite. */
static void overwritten(@{name}_real number)
{
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        state.memory[i] = number;
    }
    if (PREDICTS) {
        expect(holds(@{NAME}_BAD_RESULT), "BAD_RESULT from a memory that is not finite, and the last output held");
        expect(holds(@{NAME}_WENT_BACK), "WENT_BACK after it, and the last output held");
    } else {
        (void)step();
        (void)step();
    }
    expect(step() == @{NAME}_OK, "OK after the memory was overwritten");
}

{% if far %}
/* The longest way through a sine: the robot stands at angles beyond those that are reduced quickly. */
static void far_away(void)
{
#ifndef @{NAME}_WITHOUT_REST
    @{name}_real q[@{far.joints}], rest[@{NAME}_STATES + @{NAME}_INPUTS];
    for (int i = 0; i < @{far.joints}; ++i) {
        q[i] = @{far.angle};
    }
    expect(@{name}_rest(&param, q, rest) == @{NAME}_OK, "rest at large angles");
    expect(@{name}_start(&state, &param, rest, rest + @{NAME}_STATES) == @{NAME}_OK, "a start at large angles");
    give();
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = @{far.angle};
    }
{% if code.rests %}
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        input.r[i] = rest[i];
    }
{% endif %}
    (void)step();
    (void)step();
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        input.y[i] = @{far.largest}; /* finite: its square is not, and the memory goes back from there */
    }
    for (int k = 0; k < 4; ++k) {
        (void)step();
    }
#endif
}

{% endif %}
/* Parts of the state that an overwritten memory may change: what is applied is still an input that may be. */
static void overwritten_parts(void)
{
    const @{name}_real beyond[3] = {(@{name}_real)NAN, (@{name}_real)HUGE_VAL, -(@{name}_real)HUGE_VAL};
    @{name}_real begun[@{NAME}_INPUTS];
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    input.measured = 0;
    (void)step();
    for (int i = 0; i < @{NAME}_INPUTS; ++i) {
        begun[i] = output.u[i];
    }
    for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            state.held[i] = beyond[k];
        }
        for (int i = 0; i < @{NAME}_STATES; ++i) {
            state.estimate[i] = beyond[k];
        }
        expect(step() == @{NAME}_WAITING, "WAITING after a part of the state was overwritten");
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            expect(output.u[i] >= begun[i] && output.u[i] <= begun[i], "the input of the start where the last one is none");
        }
        expect(output.estimate[0] >= 0 && output.estimate[0] <= 0, "an estimate of zero where it was overwritten");
    }
    for (int k = 0; k < 2; ++k) { /* finite, and beyond the limits */
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            const @{name}_real least = @{name}_defaults.value[@{NAME}_P_LOWER + i], most = @{name}_defaults.value[@{NAME}_P_UPPER + i];
            const @{name}_real end = (k == 0) ? least - 1 : most + 1;
            state.held[i] = end;
        }
        expect(step() == @{NAME}_WAITING, "WAITING after an input was overwritten");
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            expect(output.u[i] >= begun[i] && output.u[i] <= begun[i], "the input of the start where the last one is beyond");
        }
    }
    for (int k = 0; k < 2; ++k) { /* every memory, or what is applied until there is a measurement */
        give();
        for (int j = 0; j < 3 && k == 0; ++j) {
            (void)step();
        }
        input.measured = (k == 0) ? 1 : 0;
        for (int i = 0; i < @{NAME}_MEMORY; ++i) {
            state.start[i] = (@{name}_real)NAN;
            state.older[i] = (@{name}_real)NAN;
            state.memory[i] = (k == 0) ? (@{name}_real)NAN : state.memory[i];
        }
        if (PREDICTS && k == 0) {
            expect(holds(@{NAME}_BAD_RESULT) && holds(@{NAME}_WENT_BACK), "WENT_BACK where every memory was overwritten");
            expect(step() == @{NAME}_OK, "OK after every memory was overwritten");
        }
        for (int i = 0; i < @{NAME}_INPUTS && k == 1; ++i) {
            state.held[i] = (@{name}_real)NAN;
        }
        (void)step();
    }
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    give();
    state.refused = @{NAME}_BAD_ARITHMETIC; /* as @{name}_init may find */
    expect(step() == @{NAME}_BAD_ARITHMETIC && holds(@{NAME}_BAD_ARITHMETIC), "BAD_ARITHMETIC, and nothing is computed");
    input.measured = 0;
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    state.unseen[0] = 32766;
    (void)step();
    expect(output.unseen[0] == 32767, "a count of 32767");
    (void)step();
    expect(output.unseen[0] == 32767, "a count that ends");
    state.unseen[0] = -2;
    (void)step();
    expect(output.unseen[0] == 32767, "a count that was overwritten");
    give();
    expect(step() == @{NAME}_OK && output.unseen[0] == 0, "a count from zero");
    state.missing = -1;
    input.measured = 0;
    expect(holds(@{NAME}_STOPPED), "STOPPED where the count of missing samples was overwritten");
    if (@{NAME}_COMMANDS > 0) {
        give();
        state.missing = -1;
        input.r[0] = (@{name}_real)NAN;
        expect(holds((param.missing_limit > 0) ? @{NAME}_STOPPED : @{NAME}_BAD_COMMAND), "STOPPED there with a bad command too");
        param.missing_limit = 0;
        expect(holds(@{NAME}_BAD_COMMAND), "BAD_COMMAND where no sample may be missing");
        param = @{name}_defaults;
    }
    give();
    expect(step() == @{NAME}_OK, "OK after it");
    if (PREDICTS && @{NAME}_COMMANDS > 0) {
        input.measured = 0;
        input.r[0] = (@{name}_real)NAN;
        expect(holds(@{NAME}_BAD_COMMAND), "BAD_COMMAND without a measurement");
    }
    give();
    state.samples = -7;
    expect(step() == @{NAME}_OK && state.samples == 1, "a count of good samples from the start");
    state.samples = 32000;
    expect(step() == @{NAME}_OK && state.samples == 1, "a count of good samples that ends");
}

/* What may stand in the place of a number: none, the opposite, another size, and what is not finite. */
static @{name}_real other(@{name}_real number, int kind)
{
    const @{name}_real large = number * 1000000 + 1;
    return (kind == 0)   ? 0
           : (kind == 1) ? -number
           : (kind == 2) ? large
           : (kind == 3) ? number / 1000000
           : (kind == 4) ? (@{name}_real)NAN
                         : (@{name}_real)HUGE_VAL;
}

static void some_steps(void)
{
    (void)step();
    (void)step();
    input.measured = 0;
    (void)step();
    give();
}

/* One number after the other is another one: of the parameters from the start on, and of the memory. Whatever comes of
 * it, `step` looks at what is applied; afterwards all goes on from a start. */
static void other_numbers(void)
{
{% if flips %}
    static const int fails[@{flips | length}] = {
@{in_lines(flips)}
    };
{% endif %}
    enum { KINDS = 6, MOST = @{most_flips}, PARAMETERS = 1 + @{NAME}_PARAMETERS / MOST, MEMORIES = 1 + @{NAME}_MEMORY / MOST };
    @{name}_real elsewhere[@{NAME}_STATES];
    for (int i = 0; i < @{NAME}_STATES; ++i) {
        elsewhere[i] = first_estimate[i] + (@{name}_real)0.125;
    }
    for (int i = 0; i < @{NAME}_PARAMETERS; i += PARAMETERS) {
        const int is_limit = i >= @{NAME}_P_LOWER && i < @{NAME}_P_LOWER + @{NAME}_INPUTS;
        const int is_other = i >= @{NAME}_P_UPPER && i < @{NAME}_P_UPPER + @{NAME}_INPUTS;
        for (int k = 0; k < KINDS && !is_limit && !is_other; ++k) {
            param.value[i] = other(@{name}_defaults.value[i], k);
            expect(@{name}_start(&state, &param, elsewhere, NULL) == @{NAME}_OK, "a start with another parameter");
            some_steps();
            expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start with another parameter");
            some_steps();
        }
        param = @{name}_defaults;
    }
    for (int i = 0; i < @{NAME}_MEMORY; i += MEMORIES) {
        for (int k = 0; k < KINDS; ++k) {
            int code = @{NAME}_BAD_RESULT, first;
            expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
            some_steps();
            state.memory[i] = other(state.memory[i], k);
            first = step();
{% if flips %}
            expect(k != 1 || (first == @{NAME}_BAD_RESULT) == (fails[i / MEMORIES] != 0), "BAD_RESULT where a number of the memory cannot be");
{% else %}
            (void)first;
{% endif %}
            some_steps();
            for (int j = 0; j < 16 && code != @{NAME}_OK && code != UNMEASURED; ++j) {
                code = step(); /* UNMEASURED: what was seen before was overwritten, and this is not believed yet */
            }
            expect(code == @{NAME}_OK || code == UNMEASURED || !PREDICTS, "OK some samples after a number was overwritten");
        }
    }
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
}

{% if nones %}
/* One number of the memory after the other is none: a step fails, or does not read it. */
static void one_is_none(void)
{
    static const int fails[@{nones | length}] = {
@{in_lines(nones)}
    };
    enum { PLACES = 1 + @{NAME}_MEMORY / @{most_nones} };
    for (int i = 0; i < @{NAME}_MEMORY; i += PLACES) {
        expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
        some_steps();
        state.memory[i] = (@{name}_real)NAN;
        expect((step() == @{NAME}_BAD_RESULT) == (fails[i / PLACES] != 0), "BAD_RESULT where a number of the memory is none");
    }
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
}

{% endif %}
{% if turned %}
/* One parameter after the other has the other sign, but for limits of inputs: a step fails, or goes on. */
static void one_is_turned(void)
{
    static const int fails[@{turned | length}] = {
@{in_lines(turned)}
    };
    enum { PLACES = 1 + @{NAME}_PARAMETERS / @{most_nones} };
    for (int i = 0; i < @{NAME}_PARAMETERS; i += PLACES) {
        const int is_lower = i >= @{NAME}_P_LOWER && i < @{NAME}_P_LOWER + @{NAME}_INPUTS;
        const int is_upper = i >= @{NAME}_P_UPPER && i < @{NAME}_P_UPPER + @{NAME}_INPUTS;
        param.value[i] = (is_lower || is_upper) ? param.value[i] : -param.value[i];
        expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start with another parameter");
        give();
        expect((step() == @{NAME}_BAD_RESULT) == (fails[i / PLACES] != 0), "BAD_RESULT where a parameter cannot be");
        param = @{name}_defaults;
    }
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
}

{% endif %}
/* Some time after the start the memory goes back to an earlier one, and soon after it to the start, with the command of
 * before{% if brakes %}; a brake under way goes on{% endif %}. */
static void goes_back(void)
{
    static @{name}_real before[@{NAME}_MEMORY];
{% if brakes %}
    static const int brakes[@{brakes | length}] = {@{brakes | join(", ")}};
    static const @{name}_real parts[3] = {0.25@{F}, 0.0@{F}, 1.5@{F}}; /* the last one is none */
{% endif %}
    for (int k = 0; k < 3; ++k) {
        const int soon = (k == 1) ? 1 : 0;
        int same = 1;
        expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
        give();
        state.began_again = (soon != 0) ? 0 : 1; /* until there is another memory to go back to */
        for (int j = 0; j < ((soon != 0) ? 2 : 3 * @{spacing}); ++j) {
            input.y[0] = first_y[0] + (@{name}_real)(1e-4 * (j % 7));
            (void)step();
        }
        for (int i = 0; i < @{NAME}_MEMORY; ++i) {
            before[i] = state.older[i];
            state.memory[i] = (i > 0) ? (@{name}_real)NAN : before[i] + 1; /* a number goes back too */
        }
        for (int i = @{commanded.start}; i < @{commanded.stop}; ++i) {
            state.memory[i] = before[i] + (@{name}_real)0.25;
            before[i] = (soon != 0) ? state.memory[i] : before[i];
        }
{% if brakes %}
        for (int i = 0; i < @{brakes | length}; ++i) {
            state.memory[brakes[i]] = parts[k];
            before[brakes[i]] = (k < 2) ? parts[k] : before[brakes[i]];
        }
{% endif %}
        expect(state.began_again == 0, "no memory that was gone back to");
        if (PREDICTS) {
            expect(holds(@{NAME}_BAD_RESULT) && holds(@{NAME}_WENT_BACK), "WENT_BACK later");
            for (int i = 0; i < @{NAME}_MEMORY; ++i) {
                same = (state.memory[i] >= before[i] && state.memory[i] <= before[i]) ? same : 0;
            }
            expect(same, "the memory of an earlier sample");
            expect(state.began_again == soon, "whether it was that of the start");
            expect(from_start(), "earlier memories that are those of the start");
            give();
            expect(step() == @{NAME}_OK, "OK from an earlier memory");
        }
    }
}

/* A start that fails again itself is forgotten: all memories are those of init. */
static void forgotten_start(void)
{
    static @{name}_real before[@{NAME}_MEMORY];
    int same = 1;
    expect(@{name}_init(&state) == @{NAME}_OK, "init again");
    give();
    expect(step() == @{NAME}_OK, "OK after init");
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        before[i] = state.start[i];
        state.start[i] = before[i] + 1;
        state.older[i] = state.start[i];
        state.memory[i] = (@{name}_real)NAN;
    }
    state.began_again = 1; /* from that start, a sample ago */
    expect(holds(@{NAME}_BAD_RESULT) && holds(@{NAME}_WENT_BACK), "WENT_BACK to init");
    for (int i = 0; i < @{NAME}_MEMORY; ++i) {
        same = same && state.start[i] >= before[i] && state.start[i] <= before[i];
        same = same && state.memory[i] >= before[i] && state.memory[i] <= before[i];
    }
    expect(same && from_start(), "memories that are those of init");
    give();
    expect(step() == @{NAME}_OK, "OK from the memory of init");
}

/* A start from an input beyond the limits begins at the limit; wider limits of the caller widen nothing. */
static void wide(void)
{
    @{name}_real far[@{NAME}_INPUTS];
    for (int k = 0; k < 2; ++k) {
        param = @{name}_defaults;
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            const @{name}_real least = @{name}_defaults.value[@{NAME}_P_LOWER + i], most = @{name}_defaults.value[@{NAME}_P_UPPER + i];
            const int limited = isfinite(least) && isfinite(most);
            far[i] = limited ? ((k == 0) ? most + (most - least) : least - (most - least)) : 0;
            if (limited) {
                param.value[@{NAME}_P_LOWER + i] = least - (most - least) * 4;
                param.value[@{NAME}_P_UPPER + i] = most + (most - least) * 4;
            }
        }
        expect(@{name}_start(&state, &param, NULL, far) == @{NAME}_OK, "a start from a large input");
        give();
        input.measured = 0;
        expect(step() == @{NAME}_WAITING, "WAITING after a start");
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            const @{name}_real least = @{name}_defaults.value[@{NAME}_P_LOWER + i], most = @{name}_defaults.value[@{NAME}_P_UPPER + i];
            const @{name}_real end = (k == 0) ? most : least;
            const int limited = isfinite(least) && isfinite(most);
            expect(!limited || (output.u[i] >= end && output.u[i] <= end), "a start at the limit");
        }
        give();
        for (int j = 0; j < 20; ++j) {
            for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
                input.y[i] = first_y[i] + (@{name}_real)((k == 0) ? 1 : -1);
            }
            (void)step(); /* it looks at the limits */
        }
    }
    param = @{name}_defaults;
    expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
    give();
}

static @{name}_real farthest;

static int near(@{name}_real found, @{name}_real expected)
{
    const @{name}_real size = 1 + fabs@{f}(expected);
    const @{name}_real away = fabs@{f}(found - expected) / size;
    farthest = (away <= farthest) ? farthest : away;
    return away <= @{number(tight)};
}

{% include "contract_stop.c" %}

{% if starts %}
/* A start elsewhere without an input begins with the one that holds the robot there. */
static void held_starts(void)
{
    static const @{name}_real states[@{starts | length}][@{NAME}_STATES] = {
@{matrix(starts | map(attribute=0))}
    };
    static const @{name}_real inputs[@{starts | length}][@{NAME}_INPUTS] = {
@{matrix(starts | map(attribute=1))}
    };
    for (int k = 0; k < @{starts | length}; ++k) {
        expect(@{name}_start(&state, &param, states[k], NULL) == @{NAME}_OK, "a start elsewhere");
        give();
        input.measured = 0;
        expect(step() == @{NAME}_WAITING, "WAITING after a start elsewhere");
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            expect(near(output.u[i], inputs[k][i]), "the input that holds the robot there");
        }
        for (int i = 0; i < @{NAME}_STATES; ++i) {
            expect(near(output.estimate[i], states[k][i]), "the estimate of the start");
        }
        expect(output.path_rate >= 1 && output.path_rate <= 1, "a path rate of 1 at the start");
    }
    give();
}

{% endif %}
#ifndef @{NAME}_WITHOUT_CHECK
/* Places of numbers that are changed one after the other, what is written there, and what the check says of it. */
static const int tried_places[@{tries | length}] = {
@{in_lines(tries | map(attribute=0) | list)}
};
static const @{name}_real tried_values[@{tries | length}] = {
@{numbers(tries | map(attribute=1) | list)}
};
static const int tried_verdicts[@{tries | length}] = {
@{in_lines(tries | map(attribute=2) | list)}
};

/* Each changed number is accepted, or refused with its place. */
static void checks(void)
{
    for (int k = 0; k < @{tries | length}; ++k) {
        int place = -1;
        param = @{name}_defaults;
        if (tried_places[k] < @{NAME}_PARAMETERS) {
            param.value[tried_places[k]] = tried_values[k];
        } else if (tried_places[k] == @{NAME}_PARAMETERS) {
            param.oldest = tried_values[k];
        } else {
            int *const whole[3] = {&param.missing_limit, &param.stop_on, &param.category};
            *whole[tried_places[k] - @{NAME}_PARAMETERS - 1] = (int)tried_values[k];
        }
        expect(@{name}_check(&param, &place) == tried_verdicts[k], "what the check says of a number");
        expect(place == ((tried_verdicts[k] == @{NAME}_PARAM_OK) ? -1 : tried_places[k]), "the place of a number that is refused");
        expect(@{name}_check(&param, NULL) == tried_verdicts[k], "a check without a place");
    }
    param = @{name}_defaults;
    param.oldest = (@{name}_real)NAN;
    expect(@{name}_check(&param, NULL) == @{NAME}_PARAM_NOT_FINITE, "an age of NaN is refused");
    param = @{name}_defaults;
}
#endif

{% if rests %}
#ifndef @{NAME}_WITHOUT_REST
/* Rest at poses{% if slower %}, and a motion that is slowed{% endif %}, as computed elsewhere. */
static void rests(void)
{
    static const @{name}_real poses[@{rests | length}][@{rests[0][0] | length}] = {
@{matrix(rests | map(attribute=0))}
    };
    static const @{name}_real expected[@{rests | length}][@{NAME}_STATES + @{NAME}_INPUTS] = {
@{matrix(rests | map(attribute=1))}
    };
    @{name}_real r[@{NAME}_STATES + @{NAME}_INPUTS];
    for (int k = 0; k < @{rests | length}; ++k) {
        for (int i = 0; i < @{NAME}_STATES + @{NAME}_INPUTS; ++i) {
            r[i] = 1; /* nothing of it stays */
        }
        expect(@{name}_rest(&param, poses[k], r) == @{NAME}_OK, "rest at a pose");
        for (int i = 0; i < @{NAME}_STATES + @{NAME}_INPUTS; ++i) {
            expect(near(r[i], expected[k][i]), "state and input at rest");
        }
    }
    r[0] = (@{name}_real)NAN;
    expect(@{name}_rest(&param, r, r) == @{NAME}_BAD_COMMAND, "no rest at a pose that is not finite");
{% if slower %}
    {
        static const @{name}_real rates[@{slower | length}] = {@{row(slower | map(attribute=0) | list)}};
        static const @{name}_real motion[@{NAME}_COMMANDS] = {@{row(slower[0][1])}};
        static const @{name}_real slow[@{slower | length}][@{NAME}_COMMANDS] = {
@{matrix(slower | map(attribute=2))}
        };
        for (int k = 0; k < @{slower | length} + 2; ++k) {
            const @{name}_real rate = (k < @{slower | length}) ? rates[k] : (@{name}_real)NAN;
            for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
                r[i] = motion[i];
            }
            if (k > @{slower | length}) { /* a command that is none */
                r[@{NAME}_COMMANDS - 1] = (@{name}_real)HUGE_VAL;
            }
            if (k >= @{slower | length}) {
                expect(@{name}_slowed(&param, (k > @{slower | length}) ? (@{name}_real)0.5 : rate, r) == @{NAME}_BAD_COMMAND, "nothing slower than what is none");
            } else {
                expect(@{name}_slowed(&param, rate, r) == @{NAME}_OK, "a slower motion");
                for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
                    expect(near(r[i], slow[k][i]), "the command of a slower motion");
                }
            }
        }
    }
{% endif %}
}
#endif

{% endif %}
/* The time between steps, as shares of the period: how long until it is refused, and when it is right again. */
static void periods(void)
{
    static const @{name}_real share[6] = {1.5@{F}, 2.5@{F}, 0.5@{F}, 1.05@{F}, 0.95@{F}, 50.0@{F}};
    static const int refused[6] = {8, 3, 8, 0, 0, 2}; /* after how many steps; 0: never */
    for (int k = 0; k < 8; ++k) {
        int first = 0;
        expect(@{name}_start(&state, &param, NULL, NULL) == @{NAME}_OK, "a start without arguments");
        give();
        for (int j = 1; j <= 200 && first == 0; ++j) {
            const @{name}_output before = output;
            const @{name}_real none = (k == 6) ? (@{name}_real)NAN : -@{NAME}_PERIOD;
            input.elapsed = (k < 6) ? share[k] * @{NAME}_PERIOD : none;
            if (step() == @{NAME}_BAD_PERIOD) {
                first = j;
                for (int i = 0; i < @{NAME}_INPUTS && j > 1; ++i) {
                    expect(output.u[i] >= before.u[i] && output.u[i] <= before.u[i], "the last output at a wrong period");
                }
            }
        }
        expect(first == ((k < 6) ? refused[k] : 2), "BAD_PERIOD after so many steps");
        for (int j = 0; j < 100; ++j) {
            input.elapsed = @{NAME}_PERIOD;
            (void)step();
        }
        expect(step() == @{NAME}_OK, "OK where the period is right again");
        input.elapsed = 3 * @{NAME}_PERIOD;
        expect(step() == @{NAME}_OK, "OK at a single late step");
    }
    for (int k = 0; k < 3; ++k) { /* as by an overwritten memory */
        state.slip = (k == 0) ? (@{name}_real)HUGE_VAL : (k == 1) ? -2 : (@{name}_real)NAN;
        input.elapsed = @{NAME}_PERIOD;
        expect(step() == @{NAME}_OK, "OK after what is known of the period was overwritten");
        expect(state.slip >= 0 && state.slip <= 0, "a period that is known anew");
    }
    state.slip = 1;
    input.elapsed = 0;
    expect(step() == @{NAME}_OK, "OK where the time is not known");
    give();
}

static void limits(void)
{
    int place = -1;
    @{name}_real least = @{name}_defaults.value[@{NAME}_P_LOWER], most = @{name}_defaults.value[@{NAME}_P_UPPER];
    const int limited = isfinite(least) && isfinite(most);
    for (int k = 0; k < 2; ++k) { /* below what was held and above it; `step` looks at what comes of it */
        @{name}_real end;
        param = @{name}_defaults;
        (void)step();
        if (!isfinite(@{name}_defaults.value[@{NAME}_P_LOWER])) { /* the design states none: this is yours */
            least = output.u[0] - 1;
        }
        if (!isfinite(@{name}_defaults.value[@{NAME}_P_UPPER])) {
            most = output.u[0] + 1;
        }
        end = (k == 0) ? least : most;
        param.value[@{NAME}_P_LOWER] = output.u[0] + (end - output.u[0]) * (@{name}_real)((k == 0) ? 0.5 : 0.25);
        param.value[@{NAME}_P_UPPER] = output.u[0] + (end - output.u[0]) * (@{name}_real)((k == 0) ? 0.25 : 0.5);
        if (@{NAME}_COMMANDS > 0) {
            const @{name}_real near = param.value[(k == 0) ? @{NAME}_P_UPPER : @{NAME}_P_LOWER];
            input.r[0] = (@{name}_real)NAN;
            expect(step() == @{NAME}_BAD_COMMAND, "BAD_COMMAND within narrower limits");
            expect(output.u[0] >= near && output.u[0] <= near, "what is held moves to the nearer of narrower limits");
        }
        give();
        (void)step();
    }
    param.value[@{NAME}_P_LOWER] = least + (most - least) / 4;
    param.value[@{NAME}_P_UPPER] = least + (most - least) / 2;
#ifndef @{NAME}_WITHOUT_CHECK
    expect(@{name}_check(&param, &place) == @{NAME}_PARAM_OK, "narrower limits may be used");
    param.value[@{NAME}_P_UPPER] = most + (most - least);
    if (limited) {
        expect(@{name}_check(&param, &place) == @{NAME}_PARAM_BEYOND_DESIGN, "wider limits are refused");
        expect(place == @{NAME}_P_UPPER, "the place of a limit that is too wide");
    }
    param.value[@{NAME}_P_UPPER] = param.value[@{NAME}_P_LOWER];
    expect(@{name}_check(&param, &place) == @{NAME}_PARAM_NOT_PHYSICAL, "limits out of order are refused");
    param.value[@{NAME}_P_UPPER] = (@{name}_real)NAN;
    expect(@{name}_check(&param, &place) == @{NAME}_PARAM_NOT_FINITE && place == @{NAME}_P_UPPER, "limits of NaN are refused");
#endif
    param = @{name}_defaults;
}

int main(void)
{
    param = @{name}_defaults;
    give();
    starts();
    arithmetic();
    bad_start();
    samples();
    overwritten((@{name}_real)NAN);
    overwritten((@{name}_real)HUGE_VAL);
    overwritten_parts();
    other_numbers();
{% if nones %}
    one_is_none();
{% endif %}
{% if turned %}
    one_is_turned();
{% endif %}
    goes_back();
    if (PREDICTS) {
        forgotten_start();
    }
    periods();
    limits();
    wide();
    reasons();
{% if code.rests %}
#ifndef @{NAME}_WITHOUT_REST
{% endif %}
    stops();
{% if code.rests %}
#endif
{% endif %}
    looks();
{% if starts %}
    held_starts();
{% endif %}
#ifndef @{NAME}_WITHOUT_CHECK
    checks();
#endif
{% if rests %}
#ifndef @{NAME}_WITHOUT_REST
    rests();
#endif
{% endif %}
{% if far %}
    far_away();
{% endif %}
    printf("@{name}: rest, starts and stops, farthest %.3g from what was computed elsewhere (allowed %.3g)\n", (double)farthest,
           @{"%.3g" | format(tight)});
    printf("@{name}: the contract %s\n", (wrong == 0) ? "holds: passed" : "is broken: FAILED");
    return (wrong == 0) ? 0 : 1;
}
