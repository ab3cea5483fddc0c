/* The rows of rows.csv again: C against Python. */
#include "@{name}.h"

#include <math.h>
#include <stdio.h>

static const double path[@{samples}][@{count}] = {
@{path}
};
static const double expected[@{samples}][@{4 * count}] = {
@{expected}
};

int main(void)
{
    @{name}_state state;
    @{name}_output output;
    const double *const parts[4] = {
        output.command, output.motor_position, output.motor_velocity, output.motor_torque};
    double worst = 0.0;
    double broken[@{count}];
    if (@{name}_init(&state, path[0]) != 0) {
        return 1;
    }
    for (int k = 0; k < @{samples}; ++k) {
        if (@{name}_step(&state, path[k], &output) != 0) {
            return 1;
        }
        for (int j = 0; j < @{4 * count}; ++j) {
            const double wanted = expected[k][j];
            const double found = parts[j / @{count}][j % @{count}];
            worst = fmax(worst, fabs(found - wanted) / (1.0 + fabs(wanted)));
        }
    }
    for (int j = 0; j < @{count}; ++j) {
        broken[j] = NAN;
    }
    if ((@{name}_step(&state, broken, &output) & 1) != 1 || !isfinite(output.command[0])) {
        printf("a path that is not finite is not refused\n");
        return 1;
    }
    printf("largest difference of @{samples} rows: %g\n", worst);
    return worst < @{close} ? 0 : 1;
}
