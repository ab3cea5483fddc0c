{% import "drives.c" as drives with context %}
/* How @{name} is used: one call before the loop, one call in it. The functions of your board are yours. */
#include "@{name}.h"

#include <string.h>

/* Of your board. Elements of the arrays have names in @{name}.h, such as those that begin with @{NAME}_Y_. */
extern void wait_for_sample(void);
extern int drives_enabled(void); /* 0 while the motors have no power, or the brakes of the robot are closed */
extern int read_sensors(@{name}_real *y); /* 0 where there was no measurement in time */
extern void read_command(@{name}_real *r, @{name}_real path_rate); /* path_rate periods further along its path{% if code.slows %}, and where that is below 1, @{name}_slowed{% endif %} */
extern void drive_motors(const @{name}_real *u);
extern @{name}_real seconds_since_sample(void); /* by a clock that does not make the period; 0 where there is none */
extern void report(int code);       /* for a log */
extern void refused(int why);       /* for a log: @{NAME}_START_..., why it does not begin; 0 while it looks */
extern void restart_watchdog(void); /* which brakes the robot too, where samples fail for longer than it may run on */
extern void brake(int stop);        /* takes the power of the drives and closes the brakes; stop says why, as output.stop */

static @{name}_state state; /* too large for most stacks */

/* @{home.text}, where @{name}_init believes the robot. */
static const @{name}_real home[] = {@{row(home.numbers)}};

@{drives.begin_with()}
@{drives.begin_here()}

int main(void)
{
    @{name}_input input = {0};
    @{name}_output output = {0};
    int enabled = @{NAME}_ENABLED;
    int acts = 1; /* once 0 it stays so: look at the robot, then begin again with @{name}_start */
    const int begun = begin_with(&state);
    if (begun != @{NAME}_OK) { /* two exports, or compiled with flags that change results */
        brake(@{NAME}_STOP_STEP_FAILED);
        return 1;
    }
    @{drives.rest_at_home("input.r")} /* the command until there is another */
    @{name}_step(&state, &@{name}_defaults, &input, &output); /* without a measurement: the input before the first */
    while (acts) {
        int code;
        wait_for_sample();
        input.measured = read_sensors(input.y);
        enabled = still_enabled(enabled, &input, &output);
        read_command(input.r, output.path_rate);
        if (@{NAME}_LATENCY > 0) { /* the input of the sample before acts from here on; further samples are the drive's */
            drive_motors(output.u);
        }
        input.elapsed = seconds_since_sample();
        code = @{name}_step(&state, &@{name}_defaults, &input, &output);
        report(code);
        acts = (@{NAME}_ENABLED != 0) ? 1 : @{name}_may_act(&state, &@{name}_defaults, code, &output); /* a controlled stop has an output.u of its own */
        if (acts && code == @{NAME}_OK) {
            restart_watchdog();
        }
        if (!acts) {
            brake(output.stop);
        } else if (@{NAME}_LATENCY == 0) {
            drive_motors(output.u);
        } else {
            /* it acts from the next sample on */
        }
    }
    return 1;
}
