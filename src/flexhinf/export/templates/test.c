/* Test vector of @{name}: a run recorded by flexhinf @{version}, with samples that are missing or not finite.
 * Exit code 0 if every answer is that of the recording: inputs, estimates, codes and status. */
#include "@{name}.h"

#include <math.h>
#include <stdio.h>

enum { SAMPLES = @{codes | length}, RUNS = @{runs | length}, EVERY = @{every}, PARTS = @{sizes | length}, MOVED = @{moved} };

/* From sample MOVED on, measured positions are moved away and back: a part with sizes and tolerances of its own. */
static int part_of(int sample)
{
    return (sample < MOVED) ? 0 : PARTS - 1;
}

/* Of the runs without and with fused multiply-adds, the one that this build repeats. */
#define RUN @{name ~ "_fused" if runs | length > 1 else 0}

/* Largest errors of inputs and estimates in each part, relative to the largest value of each signal there. */
static const @{name}_real tolerance[PARTS] = { @{row(allowed.inputs)} };
static const @{name}_real tolerance_of_estimates[PARTS] = { @{row(allowed.estimates)} };

/* Measurements, whether there is one, and commands; what must come of them in each run, and of every EVERY-th sample what
 * is estimated; the code and the status of each step, -1 where rounding may decide about it. */
static const @{name}_real given_y[SAMPLES][@{NAME}_MEASUREMENTS] = {
@{matrix(y)}
};
static const int given_measured[SAMPLES] = {
@{in_lines(measured)}
};
static const @{name}_real given_r[SAMPLES][@{code.sizes.r}] = {
@{matrix(r)}
};
static const @{name}_real expected_u[RUNS][SAMPLES][@{NAME}_INPUTS] = {{
{% for run in runs %}
@{matrix(run.u)}
{% if not loop.last %}
}, {
{% endif %}
{% endfor %}
}};
static const @{name}_real size_of_u[PARTS][@{NAME}_INPUTS] = {
@{matrix(sizes)}
};
static const @{name}_real expected_estimate[RUNS][SAMPLES / EVERY][@{NAME}_STATES] = {{
{% for run in runs %}
@{matrix(run.estimates)}
{% if not loop.last %}
}, {
{% endif %}
{% endfor %}
}};
static const @{name}_real size_of_estimate[PARTS][@{NAME}_STATES] = {
@{matrix(sizes_of_estimates)}
};
static const int expected_code[SAMPLES] = {
@{in_lines(codes)}
};

static const int expected_status[RUNS][SAMPLES] = {{
{% for run in runs %}
@{in_lines(run.status)}
{% if not loop.last %}
}, {
{% endif %}
{% endfor %}
}};

static @{name}_state state;

int main(void)
{
    @{name}_input input = {0};
    @{name}_output output = {0};
    @{name}_real worst[PARTS] = {@{zero}}, worst_estimate[PARTS] = {@{zero}};
    int wrong_codes = 0, passed = 1;
    if (@{name}_init(&state) != @{NAME}_OK) {
        printf("@{name}: flags of the compiler change results: FAILED\n");
        return 1;
    }
    for (int k = 0; k < SAMPLES; ++k) {
        const int part = part_of(k);
        for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
            input.y[i] = given_y[k][i];
        }
        for (int i = 0; i < @{code.sizes.r}; ++i) {
            input.r[i] = given_r[k][i];
        }
        input.measured = given_measured[k];
        if (@{name}_step(&state, &@{name}_defaults, &input, &output) != expected_code[k]) {
            wrong_codes += 1;
        }
        if (expected_status[RUN][k] >= 0 && output.status != expected_status[RUN][k]) {
            wrong_codes += 1;
        }
        for (int i = 0; i < @{NAME}_INPUTS; ++i) {
            const @{name}_real error = fabs@{f}(output.u[i] - expected_u[RUN][k][i]) / size_of_u[part][i];
            if (!(error <= worst[part])) {
                worst[part] = error;
            }
        }
        for (int i = 0; i < @{NAME}_STATES && k % EVERY == 0; ++i) {
            const @{name}_real away = output.estimate[i] - expected_estimate[RUN][k / EVERY][i];
            const @{name}_real error = fabs@{f}(away) / size_of_estimate[part][i];
            if (!(error <= worst_estimate[part])) {
                worst_estimate[part] = error;
            }
        }
    }
    for (int part = 0; part < PARTS; ++part) {
        passed = passed && worst[part] <= tolerance[part] && worst_estimate[part] <= tolerance_of_estimates[part];
        printf("@{name}%s: largest relative error %.3g (allowed %.3g), of estimates %.3g (allowed %.3g)\n",
               (part == 0) ? "" : ", moved", (double)worst[part], (double)tolerance[part],
               (double)worst_estimate[part], (double)tolerance_of_estimates[part]);
    }
    passed = passed && wrong_codes == 0;
    printf("@{name}: %d samples, wrong codes %d: %s\n", (int)SAMPLES, wrong_codes, passed ? "passed" : "FAILED");
    return passed ? 0 : 1;
}
