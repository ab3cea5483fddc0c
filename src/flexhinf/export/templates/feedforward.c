#include "@{name}.h"

#include <math.h>

#define FMA(a, b, c) (((a) * (b)) + (c))

@{arithmetic}

@{functions}
/* Weights of the samples, the newest first, for the position and four derivatives. */
static const double weights[5][@{size}] = {
@{weights}
};

{% if limited %}
/* What the drives take: commands with their rates and accelerations, and torques of the motors. */
static const double largest_command[@{NAME}_JOINTS] = {@{commands}};
static const double largest_torque[@{NAME}_JOINTS] = {@{torques}};
static const double largest_rate[@{NAME}_JOINTS] = {@{rates}};
static const double largest_acceleration[@{NAME}_JOINTS] = {@{accelerations}};

/* 2 where an output is beyond that, else 0. */
static int beyond_limits(@{name}_state *state, const double *command, const double *torque)
{
    int beyond = 0;
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        const double rate = state->moved ? (command[j] - state->command[j]) / @{seconds} : 0.0;
        const double change = state->moved ? (rate - state->rate[j]) / @{seconds} : 0.0;
        beyond |= (fabs(rate) > largest_rate[j]) || (fabs(change) > largest_acceleration[j]);
        beyond |= (fabs(command[j]) > largest_command[j]) || (fabs(torque[j]) > largest_torque[j]);
        state->command[j] = command[j];
        state->rate[j] = rate;
    }
    state->moved = 1;
    return beyond ? 2 : 0;
}

{% endif %}
{% if shaper %}
{% include "shaper.c" %}

{% endif %}
int @{name}_init(@{name}_state *state, const double *path)
{
    for (int i = 0; i < @{NAME}_SAMPLES; ++i) {
        for (int j = 0; j < @{NAME}_JOINTS; ++j) {
            state->path[i][j] = path[j];
        }
    }
    state->newest = 0;
{% if limited %}
    state->moved = 0;
{% endif %}
{% if shaper %}
    start_shaper(state, path);
{% endif %}
    return @{name}_exact() ? 0 : 1;
}

int @{name}_step(@{name}_state *state, const double *path, @{name}_output *output)
{
    double motion[5][@{NAME}_JOINTS];
{% if shaper %}
    double shaped[@{NAME}_JOINTS];
{% endif %}
    const int newest = (state->newest + 1) % @{NAME}_SAMPLES;
    const double *const before = state->path[state->newest];
    int failed = 0;
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        failed |= !isfinite(path[j]);
    }
{% if shaper %}
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        state->streamed[j] = failed ? state->streamed[j] : path[j];
    }
    const int slow = shape(state, shaped);
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        state->path[newest][j] = isfinite(shaped[j]) ? shaped[j] : before[j];
    }
{% else %}
    for (int j = 0; j < @{NAME}_JOINTS; ++j) {
        state->path[newest][j] = failed ? before[j] : path[j];
    }
{% endif %}
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
    @{called}(@{arguments});
{% if limited %}
    failed += beyond_limits(state, output->command, output->motor_torque);
{% endif %}
{% if shaper %}
    failed += slow ? 4 : 0;
{% endif %}
    return failed;
}
