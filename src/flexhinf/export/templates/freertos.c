{% import "drives.c" as drives with context %}
/* @{name} as a task of FreeRTOS, with static memory (configSUPPORT_STATIC_ALLOCATION). Call @{name}_task() before the
 * scheduler starts. A template: compiled against stubs of the kernel's functions. Put @{name}.h and @{name}.c beside it. */
#include "FreeRTOS.h"
#include "task.h"

#include "@{name}.h"

#include <string.h>

/* Words of stack: what `make cortex-m4-contract` prints of a step, and room for your functions and for interrupts. */
#ifndef @{NAME}_STACK_WORDS
#define @{NAME}_STACK_WORDS 4096
#endif

/* The period in ticks; the array has a negative size where it is no whole number of them: change configTICK_RATE_HZ. */
#define PERIOD_US @{(1e6 * c.period) | round | int}ull
#define PERIOD_TICKS ((TickType_t)(PERIOD_US * configTICK_RATE_HZ / 1000000u))
typedef char whole_ticks[(PERIOD_US * configTICK_RATE_HZ) % 1000000u == 0 && PERIOD_TICKS > 0 ? 1 : -1];

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
void @{name}_task(void);

static @{name}_state state;
static StackType_t stack[@{NAME}_STACK_WORDS];
static StaticTask_t task;

/* @{home.text}, where @{name}_init believes the robot. */
static const @{name}_real home[] = {@{row(home.numbers)}};

@{drives.begin_here()}
static void control(void *unused)
{
    @{name}_input input = {0};
    @{name}_output output = {0};
    int enabled = @{NAME}_ENABLED;
    TickType_t woken = xTaskGetTickCount();
    const int begun = begin_with(&state);
    (void)unused;
    if (begun != @{NAME}_OK) { /* two exports, or compiled with flags that change results */
        brake(@{NAME}_STOP_STEP_FAILED);
        vTaskDelete(NULL);
    }
    @{drives.rest_at_home("input.r")} /* the command until there is another */
    @{name}_step(&state, &@{name}_defaults, &input, &output); /* without a measurement: the input before the first */
    for (;;) {
        const int in_time = xTaskDelayUntil(&woken, PERIOD_TICKS) == pdTRUE;
        int code;
        input.measured = read_sensors(input.y) && in_time; /* a period that was missed is predicted over */
        enabled = still_enabled(enabled, &input, &output);
        read_command(input.r, output.path_rate);
        if (@{NAME}_LATENCY > 0) { /* the input of the sample before acts from here on; further samples are the drive's */
            drive_motors(output.u);
        }
        input.elapsed = seconds_since_sample();
        code = @{name}_step(&state, &@{name}_defaults, &input, &output);
        report(code);
        if (is_heard(enabled, &output) != 0 && @{name}_may_act(&state, &@{name}_defaults, code, &output) == 0) { /* look at the robot, then begin again with @{name}_start */
            brake(output.stop);
            vTaskDelete(NULL);
        } else if (@{NAME}_LATENCY == 0) {
            drive_motors(output.u);
        } else {
            /* it acts from the next sample on */
        }
        if (code == @{NAME}_OK) {
            restart_watchdog();
        }
    }
}

void @{name}_task(void)
{
    (void)xTaskCreateStatic(control, "@{name}", @{NAME}_STACK_WORDS, NULL, configMAX_PRIORITIES - 1, stack, &task);
}
