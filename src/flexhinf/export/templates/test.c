/* Test vector of @NAME@: a run recorded by flexhinf @VERSION@, with samples that are missing or not finite.
 * Exit code 0 if every answer is that of the recording: inputs, estimates, codes and status. */
#include "@NAME@.h"

#include <math.h>
#include <stdio.h>

enum { SAMPLES = @SAMPLES@, RUNS = @RUNS@, EVERY = @EVERY@, PARTS = @PARTS@, MOVED = @MOVED@ };

/* From sample MOVED on, measured positions are moved away and back: a part with sizes and tolerances of its own. */
static int part_of(int sample)
{
    return (sample < MOVED) ? 0 : PARTS - 1;
}

/* Of the runs without and with fused multiply-adds, the one that this build repeats. */
#define RUN @RUN@

/* Largest errors of inputs and estimates in each part, relative to the largest value of each signal there. */
static const @NAME@_real tolerance[PARTS] = { @TOLERANCE@ };
static const @NAME@_real tolerance_of_estimates[PARTS] = { @TOLERANCE_OF_ESTIMATES@ };

/* Measurements, whether there is one, and commands; what must come of them in each run, and of every EVERY-th sample what
 * is estimated; the code and the status of each step, -1 where rounding may decide about it. */
static const @NAME@_real given_y[SAMPLES][@BIG@_MEASUREMENTS] = {
@Y@
};
static const int given_measured[SAMPLES] = {
@MEASURED@
};
static const @NAME@_real given_r[SAMPLES][@R@] = {
@COMMANDS@
};
static const @NAME@_real expected_u[RUNS][SAMPLES][@BIG@_INPUTS] = {{
@U@
}};
static const @NAME@_real size_of_u[PARTS][@BIG@_INPUTS] = {
@SIZES@
};
static const @NAME@_real expected_estimate[RUNS][SAMPLES / EVERY][@BIG@_STATES] = {{
@ESTIMATES@
}};
static const @NAME@_real size_of_estimate[PARTS][@BIG@_STATES] = {
@SIZES_OF_ESTIMATES@
};
static const int expected_code[SAMPLES] = {
@CODES@
};

static const int expected_status[RUNS][SAMPLES] = {{
@STATUS@
}};

static @NAME@_state state;

int main(void)
{
    @NAME@_input input = {0};
    @NAME@_output output = {0};
    @NAME@_real worst[PARTS] = {@ZERO@}, worst_estimate[PARTS] = {@ZERO@};
    int wrong_codes = 0, passed = 1;
    if (@NAME@_init(&state) != @BIG@_OK) {
        printf("@NAME@: flags of the compiler change results: FAILED\n");
        return 1;
    }
    for (int k = 0; k < SAMPLES; ++k) {
        const int part = part_of(k);
        for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
            input.y[i] = given_y[k][i];
        }
        for (int i = 0; i < @R@; ++i) {
            input.r[i] = given_r[k][i];
        }
        input.measured = given_measured[k];
        if (@NAME@_step(&state, &@NAME@_defaults, &input, &output) != expected_code[k]) {
            wrong_codes += 1;
        }
        if (expected_status[RUN][k] >= 0 && output.status != expected_status[RUN][k]) {
            wrong_codes += 1;
        }
        for (int i = 0; i < @BIG@_INPUTS; ++i) {
            const @NAME@_real error = @FABS@(output.u[i] - expected_u[RUN][k][i]) / size_of_u[part][i];
            if (!(error <= worst[part])) {
                worst[part] = error;
            }
        }
        for (int i = 0; i < @BIG@_STATES && k % EVERY == 0; ++i) {
            const @NAME@_real away = output.estimate[i] - expected_estimate[RUN][k / EVERY][i];
            const @NAME@_real error = @FABS@(away) / size_of_estimate[part][i];
            if (!(error <= worst_estimate[part])) {
                worst_estimate[part] = error;
            }
        }
    }
    for (int part = 0; part < PARTS; ++part) {
        passed = passed && worst[part] <= tolerance[part] && worst_estimate[part] <= tolerance_of_estimates[part];
        printf("@NAME@%s: largest relative error %.3g (allowed %.3g), of estimates %.3g (allowed %.3g)\n",
               (part == 0) ? "" : ", moved", (double)worst[part], (double)tolerance[part],
               (double)worst_estimate[part], (double)tolerance_of_estimates[part]);
    }
    passed = passed && wrong_codes == 0;
    printf("@NAME@: %d samples, wrong codes %d: %s\n", (int)SAMPLES, wrong_codes, passed ? "passed" : "FAILED");
    return passed ? 0 : 1;
}
