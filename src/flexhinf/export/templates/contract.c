/* The contract of @NAME@, rehearsed: every value that a step returns is provoked but BAD_ARITHMETIC, and what README.md says
 * of it is looked for. Made by flexhinf @VERSION@. Exit code 0 if all of it holds. */
#include "@NAME@.h"

#include <math.h>
#include <stdio.h>

enum { PREDICTS = @PREDICTS@, STARTS_ANYWHERE = @STARTS@ };

/* What a step returns for a measurement that is not finite, and for none. */
enum { NOT_FINITE = @BIG@_@NOT_FINITE@, UNMEASURED = @BIG@_@UNMEASURED@ };

/* What is measured and commanded at first. */
static const @NAME@_real first_y[@BIG@_MEASUREMENTS] = {@FIRST_Y@};
static const @NAME@_real first_r[@R@] = {@FIRST_R@};

/* Where @NAME@_init believes the robot, if it believes anything. */
static const @NAME@_real first_estimate[@BIG@_STATES] = {@FIRST_ESTIMATE@};

static @NAME@_state state;
static @NAME@_param param;
static @NAME@_input input;
static @NAME@_output output;
static int wrong;

static void expect(int holds, const char *what)
{
    if (!holds) {
        printf("@NAME@: %s: FAILED\n", what);
        wrong += 1;
    }
}

/* What is given after the first sample was: it is measured, in time. */
static void give(void)
{
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        input.y[i] = first_y[i];
    }
    for (int i = 0; i < @R@; ++i) {
        input.r[i] = first_r[i];
    }
    input.age = 0;
    input.measured = 1;
}

/* One step. Whatever it returns, its output is finite, and within the narrower of the caller's limits and the design's. */
static int step(void)
{
    const int code = @NAME@_step(&state, &param, &input, &output);
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        const @NAME@_real u = output.u[i];
        const @NAME@_real least = @NAME@_defaults.value[@BIG@_P_LOWER + i], most = @NAME@_defaults.value[@BIG@_P_UPPER + i];
        expect(isfinite(u), "an output that is finite");
        expect(u >= least && u <= most, "an output within the limits of the design");
        expect(u >= param.value[@BIG@_P_LOWER + i] && u <= param.value[@BIG@_P_UPPER + i], "an output within my limits");
    }
    for (int i = 0; i < @BIG@_STATES; ++i) {
        expect(isfinite(output.estimate[i]), "an estimate that is finite");
    }
    expect(output.path_rate >= 0 && output.path_rate <= 1, "a path rate from 0 to 1");
    return code;
}

/* Whether a step returns this, and applies what the step before did. */
static int holds(int expected)
{
    const @NAME@_output before = output;
    int right = step() == expected;
    for (int i = 0; i < @BIG@_INPUTS; ++i) {
        right = right && output.u[i] >= before.u[i] && output.u[i] <= before.u[i];
    }
    return right;
}

static void starts(void)
{
    expect(step() == @BIG@_NOT_INITIALISED, "NOT_INITIALISED before init");
    expect(@NAME@_init(&state) == @BIG@_OK, "init returns OK: the flags of the compiler change no results");
    input.measured = 0;
    expect(step() == @BIG@_WAITING && output.unseen[0] == 1, "WAITING before the first measurement");
    for (int i = 0; i < @BIG@_STATES && STARTS_ANYWHERE; ++i) {
        expect(output.estimate[i] >= first_estimate[i] && output.estimate[i] <= first_estimate[i], "the first estimate");
    }
    give();
    if (@BIG@_COMMANDS > 0) {
        input.r[0] = (@NAME@_real)NAN;
        expect(step() == @BIG@_WAITING, "WAITING with a bad command before the first measurement that is used");
        give();
    }
    expect(step() == @BIG@_OK && output.unseen[0] == 0, "OK after a measurement");
    state.mark ^= 1u; /* as by an overwritten memory */
    expect(step() == @BIG@_NOT_INITIALISED, "NOT_INITIALISED after its mark was overwritten");
    for (int k = 0; k < 2; ++k) {
        @NAME@_real estimate[@BIG@_STATES] = {0}, acting[@BIG@_INPUTS] = {0};
        const int bad = (k == 1 || STARTS_ANYWHERE) ? @BIG@_BAD_START : @BIG@_OK; /* else no estimate is read */
        estimate[@BIG@_STATES - 1] = (k == 0) ? (@NAME@_real)NAN : 0;
        acting[@BIG@_INPUTS - 1] = (k == 1) ? (@NAME@_real)HUGE_VAL : 0;
        expect(@NAME@_start(&state, &param, estimate, acting) == bad, "BAD_START for a start that is not finite");
        expect(step() == ((bad == @BIG@_OK) ? @BIG@_OK : @BIG@_NOT_INITIALISED), "NOT_INITIALISED after BAD_START");
    }
    expect(@NAME@_start(&state, &param, NULL, NULL) == @BIG@_OK, "a start without arguments");
    expect(step() == @BIG@_OK, "OK after a start");
}

static void samples(void)
{
    if (@BIG@_COMMANDS > 0) {
        for (int k = 0; k < 2; ++k) {
            input.r[@BIG@_COMMANDS - 1] = (k == 0) ? (@NAME@_real)NAN : -(@NAME@_real)HUGE_VAL;
            expect(holds(@BIG@_BAD_COMMAND), "BAD_COMMAND, and the last output held");
        }
        for (int k = 2; k < param.missing_limit; ++k) {
            expect(holds(@BIG@_BAD_COMMAND), "BAD_COMMAND again");
        }
        expect(holds((param.missing_limit > 0) ? @BIG@_STOPPED : @BIG@_BAD_COMMAND), "too many bad commands");
        give();
        expect(step() == @BIG@_OK, "OK after a bad command");
    }
    for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
            input.y[i] = (k == 0) ? (@NAME@_real)NAN : (@NAME@_real)HUGE_VAL;
        }
        expect(PREDICTS ? step() == NOT_FINITE : holds(NOT_FINITE), "a measurement that is not finite");
    }
    give();
    for (int k = 1; k < 4 && PREDICTS && @BIG@_MEASUREMENTS > 1; ++k) {
        input.y[0] = (@NAME@_real)NAN;
        expect(step() == @BIG@_OK && output.unseen[0] == k + 2, "a count of samples without one of several measurements");
        expect(output.unseen[@BIG@_MEASUREMENTS - 1] == 0, "no count of one that is there");
    }
    for (int k = 0; k < 3; ++k) {
        give();
        input.age = (k == 0) ? (@NAME@_real)NAN : (k == 1) ? -param.oldest : 2 * param.oldest;
        expect(PREDICTS ? step() == UNMEASURED : holds(UNMEASURED), "an age that is none");
    }
    give();
    expect(step() == @BIG@_OK, "OK again");
    input.measured = 0;
    for (int k = 0; k < param.missing_limit; ++k) {
        expect(step() == UNMEASURED, "PREDICTED without a measurement");
    }
    expect(holds(@BIG@_STOPPED) && holds(@BIG@_STOPPED), "STOPPED after too many, and the last output held");
    give();
    expect(step() == @BIG@_OK, "OK after STOPPED: it does not latch");
}

/* The memory is overwritten by numbers that are not finite. */
static void overwritten(@NAME@_real number)
{
    for (int i = 0; i < @BIG@_MEMORY; ++i) {
        state.memory[i] = number;
    }
    if (PREDICTS) {
        expect(holds(@BIG@_BAD_RESULT), "BAD_RESULT from a memory that is not finite, and the last output held");
        expect(holds(@BIG@_WENT_BACK), "WENT_BACK after it, and the last output held");
    } else {
        (void)step();
        (void)step();
    }
    expect(step() == @BIG@_OK, "OK after the memory was overwritten");
}

@FAR_AWAY@static void limits(void)
{
    int place = -1;
    @NAME@_real least = @NAME@_defaults.value[@BIG@_P_LOWER], most = @NAME@_defaults.value[@BIG@_P_UPPER];
    const int limited = isfinite(least) && isfinite(most);
    for (int k = 0; k < 2; ++k) { /* below what was held and above it; `step` looks at what comes of it */
        @NAME@_real end;
        param = @NAME@_defaults;
        (void)step();
        if (!isfinite(@NAME@_defaults.value[@BIG@_P_LOWER])) { /* the design states none: this is yours */
            least = output.u[0] - 1;
        }
        if (!isfinite(@NAME@_defaults.value[@BIG@_P_UPPER])) {
            most = output.u[0] + 1;
        }
        end = (k == 0) ? least : most;
        param.value[@BIG@_P_LOWER] = output.u[0] + (end - output.u[0]) * (@NAME@_real)((k == 0) ? 0.5 : 0.25);
        param.value[@BIG@_P_UPPER] = output.u[0] + (end - output.u[0]) * (@NAME@_real)((k == 0) ? 0.25 : 0.5);
        if (@BIG@_COMMANDS > 0) {
            const @NAME@_real near = param.value[(k == 0) ? @BIG@_P_UPPER : @BIG@_P_LOWER];
            input.r[0] = (@NAME@_real)NAN;
            expect(step() == @BIG@_BAD_COMMAND, "BAD_COMMAND within narrower limits");
            expect(output.u[0] >= near && output.u[0] <= near, "what is held moves to the nearer of narrower limits");
        }
        give();
        (void)step();
    }
    param.value[@BIG@_P_LOWER] = least + (most - least) / 4;
    param.value[@BIG@_P_UPPER] = least + (most - least) / 2;
#ifndef @BIG@_WITHOUT_CHECK
    expect(@NAME@_check(&param, &place) == @BIG@_PARAM_OK, "narrower limits may be used");
    param.value[@BIG@_P_UPPER] = most + (most - least);
    if (limited) {
        expect(@NAME@_check(&param, &place) == @BIG@_PARAM_BEYOND_DESIGN, "wider limits are refused");
        expect(place == @BIG@_P_UPPER, "the place of a limit that is too wide");
    }
    param.value[@BIG@_P_UPPER] = param.value[@BIG@_P_LOWER];
    expect(@NAME@_check(&param, &place) == @BIG@_PARAM_NOT_PHYSICAL, "limits out of order are refused");
    param.value[@BIG@_P_UPPER] = (@NAME@_real)NAN;
    expect(@NAME@_check(&param, &place) == @BIG@_PARAM_NOT_FINITE && place == @BIG@_P_UPPER, "limits of NaN are refused");
#endif
    param = @NAME@_defaults;
}

int main(void)
{
    param = @NAME@_defaults;
    give();
    starts();
    samples();
    overwritten((@NAME@_real)NAN);
    overwritten((@NAME@_real)HUGE_VAL);
    limits();
@FAR_CALL@    printf("@NAME@: the contract %s\n", (wrong == 0) ? "holds: passed" : "is broken: FAILED");
    return (wrong == 0) ? 0 : 1;
}
