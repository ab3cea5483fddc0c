{% import "drives.c" as drives with context %}
// @{name} in an Arduino-style sketch. A template: compiled against stubs only. Put @{name}.h and @{name}.c beside it.
#include "@{name}.h"

#include <string.h>

static @{name}_state state;
static @{name}_input input;
static @{name}_output output;
static unsigned long due_us;
static unsigned long before_us;
static int enabled;
static bool acts; // once false it stays so: look at the robot, then begin again with @{name}_start

static const unsigned long PERIOD_US = @{(1e6 * c.period) | round | int}UL;

// Of your board, in the order and the units of @{name}.h.
static bool drives_enabled(); // false while the motors have no power, or the brakes of the robot are closed
static bool read_sensors(@{name}_real *y);
static void read_command(@{name}_real *r, @{name}_real path_rate);
static void drive_motors(const @{name}_real *u);
static void report(int code);
static void refused(int why);
static void restart_watchdog();
static void brake(int stop);

// @{home.text}, where @{name}_init believes the robot.
static const @{name}_real home[] = {@{row(home.numbers)}};

@{drives.begin_with()}
@{drives.begin_here()}
void setup()
{
    const int begun = begin_with(&state);
    acts = begun == @{NAME}_OK;
    if (!acts) { // two exports, or compiled with flags that change results
        brake(@{NAME}_STOP_STEP_FAILED);
        return;
    }
    enabled = @{NAME}_ENABLED;
    @{drives.rest_at_home("input.r")} // the command until there is another
    @{name}_step(&state, &@{name}_defaults, &input, &output); // without a measurement: the input before the first
    due_us = before_us = micros();
}

void loop()
{
    if (!acts || (long)(micros() - due_us) < 0) {
        return;
    }
    due_us += PERIOD_US;
    // A period that was missed is made up for without a measurement: it is predicted over.
    const bool missed = (long)(micros() - due_us) >= 0;
    input.measured = (!missed && read_sensors(input.y)) ? 1 : 0;
    enabled = still_enabled(enabled, &input, &output);
    read_command(input.r, output.path_rate);
    if (@{NAME}_LATENCY > 0) { // the input of the sample before acts from here on; further samples are the drive's
        drive_motors(output.u);
    }
    const unsigned long now_us = micros();
    input.elapsed = (@{name}_real)(1e-6 * (now_us - before_us));
    before_us = now_us;
    const int code = @{name}_step(&state, &@{name}_defaults, &input, &output);
    report(code);
    acts = is_heard(enabled, &output) == 0 || @{name}_may_act(&state, &@{name}_defaults, code, &output) != 0;
    if (acts && code == @{NAME}_OK) {
        restart_watchdog();
    }
    if (!acts) {
        brake(output.stop);
    } else if (@{NAME}_LATENCY == 0) {
        drive_motors(output.u);
    }
}

static bool drives_enabled()
{
    return true;
}

static bool read_sensors(@{name}_real *y)
{
    for (int i = 0; i < @{NAME}_MEASUREMENTS; ++i) {
        y[i] = 0; // an encoder, in the unit of @{name}.h
    }
    return true;
}

// The command path_rate periods further along its path{% if code.slows %}, and where that is below 1, @{name}_slowed{% endif %}: less than one where the controller brakes.
// Here it stays.
static void read_command(@{name}_real *r, @{name}_real path_rate)
{
    (void)r;
    (void)path_rate;
}

static void drive_motors(const @{name}_real *u)
{
    (void)u; // a PWM or a current controller
}

static void report(int code)
{
    (void)code; // for a log
}

static void refused(int why)
{
    (void)why; // for a log: @{NAME}_START_..., why it does not begin; 0 while it looks
}

static void restart_watchdog()
{
    // which brakes the robot too, where samples fail for longer than it may run on
}

static void brake(int stop)
{
    (void)stop; // takes the power of the drives and closes the brakes, and says why; it stays so
}
