// @NAME@ in an Arduino-style sketch. A template: compiled against stubs only. Put @NAME@.h and @NAME@.c beside it.
#include "@NAME@.h"

#include <string.h>

static @NAME@_state state;
static @NAME@_input input;
static @NAME@_output output;
static unsigned long due_us;
static int enabled;
static bool acts; // once false it stays so: look at the robot, then begin again with @NAME@_start

static const unsigned long PERIOD_US = @PERIOD_US@UL;

// Of your board, in the order and the units of @NAME@.h.
static bool drives_enabled(); // false while the motors have no power, or the brakes of the robot are closed
static bool read_sensors(@NAME@_real *y);
static void read_command(@NAME@_real *r, @NAME@_real path_rate);
static void drive_motors(const @NAME@_real *u);
static void report(int code);
static void restart_watchdog();
static void brake(int code);

// @HOME_TEXT@, where @NAME@_init believes the robot.
static const @NAME@_real home[] = {@HOME@};

@MAY_ACT@
@BEGIN_HERE@
void setup()
{
    const int begun = begin_with(&state);
    acts = begun == @BIG@_OK;
    if (!acts) { // two exports, or compiled with flags that change results
        brake(begun);
        return;
    }
    enabled = @BIG@_ENABLED;
    @STANDSTILL@ // the command until there is another
    @NAME@_step(&state, &@NAME@_defaults, &input, &output); // without a measurement: the input before the first
    due_us = micros();
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
    if (@BIG@_LATENCY > 0) { // the input of the sample before acts from here on; further samples are the drive's
        drive_motors(output.u);
    }
    const int code = @NAME@_step(&state, &@NAME@_defaults, &input, &output);
    report(code);
    acts = may_act(code, &output) != 0;
    if (code == @BIG@_OK) {
        restart_watchdog();
    }
    if (!acts) {
        brake(code);
    } else if (@BIG@_LATENCY == 0) {
        drive_motors(output.u);
    }
}

static bool drives_enabled()
{
    return true;
}

static bool read_sensors(@NAME@_real *y)
{
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        y[i] = 0; // an encoder, in the unit of @NAME@.h
    }
    return true;
}

// The command path_rate periods further along its path@THEN_SLOWED@: less than one where the controller brakes.
// Here it stays.
static void read_command(@NAME@_real *r, @NAME@_real path_rate)
{
    (void)r;
    (void)path_rate;
}

static void drive_motors(const @NAME@_real *u)
{
    (void)u; // a PWM or a current controller
}

static void report(int code)
{
    (void)code; // for a log
}

static void restart_watchdog()
{
    // which brakes the robot too, where samples fail for longer than it may run on
}

static void brake(int code)
{
    (void)code; // stops the robot without the controller, whatever it needs for that; it stays so
}
