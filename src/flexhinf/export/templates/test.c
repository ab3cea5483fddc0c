/* Test vector of @NAME@: a run recorded by flexhinf @VERSION@, with samples that are missing or not finite.
 * Exit code 0 if every answer is that of the recording: inputs, estimates, codes and status. */
#include "@NAME@.h"

#include <math.h>
#include <stdio.h>

enum { SAMPLES = @SAMPLES@, RUNS = @RUNS@, EVERY = @EVERY@ };

/* Of the runs without and with fused multiply-adds, the one that this build repeats. */
#define RUN @RUN@

/* Largest errors of inputs and estimates, relative to the largest value of each signal. */
#define TOLERANCE @TOLERANCE@
#define TOLERANCE_OF_ESTIMATES @TOLERANCE_OF_ESTIMATES@

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
static const @NAME@_real size_of_u[@BIG@_INPUTS] = {
@SIZES@
};
static const @NAME@_real expected_estimate[RUNS][SAMPLES / EVERY][@BIG@_STATES] = {{
@ESTIMATES@
}};
static const @NAME@_real size_of_estimate[@BIG@_STATES] = {
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
    @NAME@_real worst = @ZERO@, worst_estimate = @ZERO@;
    int wrong_codes = 0, passed;
    if (@NAME@_init(&state) != @BIG@_OK) {
        printf("@NAME@: flags of the compiler change results: FAILED\n");
        return 1;
    }
    for (int k = 0; k < SAMPLES; ++k) {
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
            const @NAME@_real error = @FABS@(output.u[i] - expected_u[RUN][k][i]) / size_of_u[i];
            if (!(error <= worst)) {
                worst = error;
            }
        }
        for (int i = 0; i < @BIG@_STATES && k % EVERY == 0; ++i) {
            const @NAME@_real away = output.estimate[i] - expected_estimate[RUN][k / EVERY][i];
            if (!(@FABS@(away) / size_of_estimate[i] <= worst_estimate)) {
                worst_estimate = @FABS@(away) / size_of_estimate[i];
            }
        }
    }
    passed = worst <= TOLERANCE && worst_estimate <= TOLERANCE_OF_ESTIMATES && wrong_codes == 0;
    printf("@NAME@: %d samples, largest relative error %.3g (allowed %.3g), of estimates %.3g (allowed %.3g), "
           "wrong codes %d: %s\n", (int)SAMPLES, (double)worst, (double)TOLERANCE, (double)worst_estimate,
           (double)TOLERANCE_OF_ESTIMATES, wrong_codes, passed ? "passed" : "FAILED");
    return passed ? 0 : 1;
}
