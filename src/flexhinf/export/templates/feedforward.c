#include "@{name}.h"

#include <math.h>

#define FMA(a, b, c) (((a) * (b)) + (c))

@{arithmetic}

@{functions}
/* Weights of the samples, the newest first, for the position and four derivatives. */
static const double weights[5][@{size}] = {
@{weights}
};

int @{name}_init(@{name}_state *state, const double *path)
{
    for (int i = 0; i < @{NAME}_SAMPLES; ++i) {
        for (int j = 0; j < @{NAME}_JOINTS; ++j) {
            state->path[i][j] = path[j];
        }
    }
    state->newest = 0;
    return @{name}_exact() ? 0 : 1;
}

int @{name}_step(@{name}_state *state, const double *path, @{name}_output *output)
{
    double motion[5][@{NAME}_JOINTS];
    const int newest = (state->newest + 1) % @{NAME}_SAMPLES;
    const double *const before = state->path[state->newest];
    int failed = 0;
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        failed |= !isfinite(path[j]);
    }
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        state->path[newest][j] = failed ? before[j] : path[j];
    }
    state->newest = newest;
    for (int k = 0; k < 5; ++k) {
        for (int j = 0; j < @{NAME}_JOINTS; ++j) {
            /* beside the newest sample, so that a path at rest leaves no rounding in the derivatives */
            double sum = 0.0;
            int i = newest;
            for (int age = 0; age < @{NAME}_SAMPLES; ++age) {
                sum += weights[k][age] * (state->path[i][j] - state->path[newest][j]);
                i = i > 0 ? i - 1 : @{NAME}_SAMPLES - 1;
            }
            motion[k][j] = k > 0 ? sum : sum + state->path[newest][j];
        }
    }
    @{called}(@{arguments | join(', ')});
    return failed;
}
