/* @NAME@ as a task of FreeRTOS, with static memory (configSUPPORT_STATIC_ALLOCATION). Call @NAME@_task() before the
 * scheduler starts. A template: compiled against stubs of the kernel's functions. Put @NAME@.h and @NAME@.c beside it. */
#include "FreeRTOS.h"
#include "task.h"

#include "@NAME@.h"

#include <string.h>

/* Words of stack: what `make cortex-m4-contract` prints of a step, and room for your functions and for interrupts. */
#ifndef @BIG@_STACK_WORDS
#define @BIG@_STACK_WORDS 4096
#endif

/* The period in ticks; the array has a negative size where it is no whole number of them: change configTICK_RATE_HZ. */
#define PERIOD_US @PERIOD_US@ull
#define PERIOD_TICKS ((TickType_t)(PERIOD_US * configTICK_RATE_HZ / 1000000u))
typedef char whole_ticks[(PERIOD_US * configTICK_RATE_HZ) % 1000000u == 0 && PERIOD_TICKS > 0 ? 1 : -1];

/* Of your board, as in main.c. */
extern int drives_enabled(void);
extern int read_sensors(@NAME@_real *y);
extern void read_command(@NAME@_real *r, @NAME@_real path_rate);
extern void drive_motors(const @NAME@_real *u);
extern void report(int code);
extern void restart_watchdog(void);
extern void brake(int code);

@MAY_ACT@
void @NAME@_task(void);

static @NAME@_state state;
static StackType_t stack[@BIG@_STACK_WORDS];
static StaticTask_t task;

/* @HOME_TEXT@, where @NAME@_init believes the robot. */
static const @NAME@_real home[] = {@HOME@};

@BEGIN_HERE@
static void control(void *unused)
{
    @NAME@_input input = {0};
    @NAME@_output output = {0};
    int enabled = @BIG@_ENABLED;
    TickType_t woken = xTaskGetTickCount();
    const int begun = begin_with(&state);
    (void)unused;
    if (begun != @BIG@_OK) { /* two exports, or compiled with flags that change results */
        brake(begun);
        vTaskDelete(NULL);
    }
    @STANDSTILL@ /* the command until there is another */
    @NAME@_step(&state, &@NAME@_defaults, &input, &output); /* without a measurement: the input before the first */
    for (;;) {
        const int in_time = xTaskDelayUntil(&woken, PERIOD_TICKS) == pdTRUE;
        int code;
        input.measured = read_sensors(input.y) && in_time; /* a period that was missed is predicted over */
        enabled = still_enabled(enabled, &input, &output);
        read_command(input.r, output.path_rate);
        if (@BIG@_LATENCY > 0) { /* the input of the sample before acts from here on; further samples are the drive's */
            drive_motors(output.u);
        }
        code = @NAME@_step(&state, &@NAME@_defaults, &input, &output);
        report(code);
        if (code == @BIG@_OK) {
            restart_watchdog();
        }
        if (!may_act(code, &output)) { /* look at the robot, then begin again with @NAME@_start */
            brake(code);
            vTaskDelete(NULL);
        } else if (@BIG@_LATENCY == 0) {
            drive_motors(output.u);
        } else {
            /* it acts from the next sample on */
        }
    }
}

void @NAME@_task(void)
{
    (void)xTaskCreateStatic(control, "@NAME@", @BIG@_STACK_WORDS, NULL, configMAX_PRIORITIES - 1, stack, &task);
}
