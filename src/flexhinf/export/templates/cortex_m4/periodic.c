{% import "drives.c" as drives with context %}
/* @{name} in a timer interrupt of a Cortex-M: SysTick calls it once per period, and the main program is free.
 * Replace the functions that are marked. `make cortex-m4-periodic` runs it in QEMU with those of recorded.c. */
#include "@{name}.h"

#include <stdint.h>
#include <string.h>

#ifndef CORE_HZ
#define CORE_HZ 25000000.0 /* clock of your processor; this is that of the emulated board */
#endif

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SYSTICK_CONTROL REGISTER(0xe000e010u)
#define SYSTICK_RELOAD REGISTER(0xe000e014u)
#define SYSTICK_VALUE REGISTER(0xe000e018u)
#define INTERRUPT_STATE REGISTER(0xe000ed04u)
#define SYSTICK_PENDING (1u << 26)

/* Of your board, as in main.c. */
extern int drives_enabled(void);
extern int read_sensors(@{name}_real *y);
extern void read_command(@{name}_real *r, @{name}_real path_rate);
extern void drive_motors(const @{name}_real *u);
extern @{name}_real seconds_since_sample(void);
extern void report(int code);
extern void refused(int why);
extern void restart_watchdog(void);
extern void brake(int stop);

@{drives.begin_with()}
void tick(void); /* the handler of SysTick: in some vector tables it is called SysTick_Handler */

static @{name}_state state;
static @{name}_input input;
static @{name}_output output;
static int late; /* whether the sample before took longer than a period */
static int begun;

/* @{home.text}, where @{name}_init believes the robot. */
static const @{name}_real home[] = {@{row(home.numbers)}};

@{drives.begin_here()}
static int enabled = @{NAME}_ENABLED;

/* In the interrupt, as the steps: its floating-point unit may have other settings than the main program's (FPDSCR), and
 * @{name}_init looks at those that it finds. */
static int begin(void)
{
    const int code = begin_with(&state);
    @{drives.rest_at_home("input.r")} /* the command until there is another */
    return (code != @{NAME}_OK) ? code : @{name}_step(&state, &@{name}_defaults, &input, &output); /* not measured yet */
}

void tick(void)
{
    int code;
    if (!begun) {
        begun = 1;
        code = begin();
        if (code != @{NAME}_WAITING) { /* two exports, or compiled with flags that change results */
            SYSTICK_CONTROL = 0;
            brake(@{NAME}_STOP_STEP_FAILED);
            return;
        }
    }
    input.measured = read_sensors(input.y) && !late; /* an old measurement is none: it is predicted over */
    enabled = still_enabled(enabled, &input, &output);
    read_command(input.r, output.path_rate);
    if (@{NAME}_LATENCY > 0) { /* the input of the sample before acts from here on; further samples are the drive's */
        drive_motors(output.u);
    }
    input.elapsed = seconds_since_sample();
    code = @{name}_step(&state, &@{name}_defaults, &input, &output);
    report(code);
    if (is_heard(enabled, &output) != 0 && @{name}_may_act(&state, &@{name}_defaults, code, &output) == 0) { /* it is called no more: look at the robot, then begin again with @{name}_start */
        SYSTICK_CONTROL = 0;
        brake(output.stop);
        return;
    }
    if (code == @{NAME}_OK) {
        restart_watchdog();
    }
    if (@{NAME}_LATENCY == 0) {
        drive_motors(output.u); /* else it acts from the next sample on */
    }
    late = (INTERRUPT_STATE & SYSTICK_PENDING) != 0u;
}

int main(void)
{
    SYSTICK_RELOAD = (uint32_t)(CORE_HZ * (double)@{NAME}_PERIOD + 0.5) - 1u;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 7; /* the core's clock, its interrupt, on */
    for (;;) {
        __asm volatile("wfi"); /* whatever else the firmware does */
    }
}
