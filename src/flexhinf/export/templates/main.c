/* How @NAME@ is used: one call before the loop, one call in it. The functions of your board are yours. */
#include "@NAME@.h"

#include <string.h>

/* Of your board. Elements of the arrays have names in @NAME@.h, such as those that begin with @BIG@_Y_. */
extern void wait_for_sample(void);
extern int drives_enabled(void); /* 0 while the motors have no power, or the brakes of the robot are closed */
extern int read_sensors(@NAME@_real *y); /* 0 where there was no measurement in time */
extern void read_command(@NAME@_real *r, @NAME@_real path_rate); /* path_rate periods further along its path@THEN_SLOWED@ */
extern void drive_motors(const @NAME@_real *u);
extern void report(int code);       /* for a log */
extern void restart_watchdog(void); /* which brakes the robot too, where samples fail for longer than it may run on */
extern void brake(int code);        /* stops the robot without the controller, whatever it needs for that */

static @NAME@_state state; /* too large for most stacks */

/* @HOME_TEXT@, where @NAME@_init believes the robot. */
static const @NAME@_real home[] = {@HOME@};

@MAY_ACT@
@BEGIN_HERE@

int main(void)
{
    @NAME@_input input = {0};
    @NAME@_output output = {0};
    int enabled = @BIG@_ENABLED;
    int acts = 1; /* once 0 it stays so: look at the robot, then begin again with @NAME@_start */
    const int begun = begin_with(&state);
    if (begun != @BIG@_OK) { /* two exports, or compiled with flags that change results */
        brake(begun);
        return 1;
    }
    @STANDSTILL@ /* the command until there is another */
    @NAME@_step(&state, &@NAME@_defaults, &input, &output); /* without a measurement: the input before the first */
    while (acts) {
        int code;
        wait_for_sample();
        input.measured = read_sensors(input.y);
        enabled = still_enabled(enabled, &input, &output);
        read_command(input.r, output.path_rate);
        if (@BIG@_LATENCY > 0) { /* the input of the sample before acts from here on; further samples are the drive's */
            drive_motors(output.u);
        }
        code = @NAME@_step(&state, &@NAME@_defaults, &input, &output);
        report(code);
        acts = may_act(code, &output);
        if (code == @BIG@_OK) {
            restart_watchdog();
        }
        if (!acts) {
            brake(code);
        } else if (@BIG@_LATENCY == 0) {
            drive_motors(output.u);
        } else {
            /* it acts from the next sample on */
        }
    }
    return 1;
}
