/* A board for examples in QEMU: its sensors and commands are those of the test vector, and what drives the motors is
 * compared with it. Ends the emulation after the last sample. Not for a project of yours. */
#define main of_the_test_vector /* which has the numbers */
#include "../@{name}_test.c"
#undef main

#include <stdlib.h>

int drives_enabled(void);
int read_sensors(@{name}_real *y);
void read_command(@{name}_real *r, @{name}_real path_rate);
void drive_motors(const @{name}_real *u);
@{name}_real seconds_since_sample(void);
void report(int code);
void refused(int why);
void restart_watchdog(void);
void brake(int stop);

static int samples, code_before, failed;
static @{name}_real largest;

int drives_enabled(void) { return 1; }

int read_sensors(@{name}_real *y)
{
    failed += samples > 0 && code_before != expected_code[samples - 1];
    code_before = @{NAME}_OK;
    if (samples == BEGUN) {
        printf("@{name} in a periodic task: %d samples, largest relative error %.3g: %s\n", samples, (double)largest,
               failed ? "FAILED" : "passed");
        exit(failed != 0);
    }
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        y[i] = given_y[samples][i];
    }
    samples += 1;
    return given_measured[samples - 1];
}

void read_command(@{name}_real *r, @{name}_real path_rate)
{
    (void)path_rate;
    for (int i = 0; i < @{code.sizes.r}; ++i) {
        r[i] = given_r[samples - 1][i];
    }
}

void drive_motors(const @{name}_real *u)
{
    const int sample = samples - 1 - (@{NAME}_LATENCY > 0);
    for (int i = 0; i < @{NAME}_INPUTS && sample >= 0; ++i) {
        const @{name}_real error = fabs@{f}(u[i] - expected_u[RUN][sample][i]) / size_of_u[part_of[sample]][i];
        failed += !(error <= tolerance[part_of[sample]]);
        if (!(error <= largest)) {
            largest = error;
        }
    }
}

@{name}_real seconds_since_sample(void) { return 0; }

void report(int code) { code_before = code; }

void refused(int why) { (void)why; }

void restart_watchdog(void) {}

void brake(int stop)
{
    printf("@{name} in a periodic task: braked at sample %d, stop %d: FAILED\n", samples, stop);
    exit(1);
}
