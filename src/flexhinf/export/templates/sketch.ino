// @NAME@ in an Arduino-style sketch. A template: compiled against stubs only. Put @NAME@.h and @NAME@.c beside it.
#include "@NAME@.h"

static @NAME@_state state;
static @NAME@_input input;
static @NAME@_output output;
static unsigned long due_us;

static const unsigned long PERIOD_US = @PERIOD_US@UL;

// Of your board, in the order and the units of @NAME@.h.
static bool read_sensors(@NAME@_real *y);
static void read_command(@NAME@_real *r, @NAME@_real path_rate);
static void drive_motors(const @NAME@_real *u);
static void watch(int code);

void setup()
{
    // The robot must be where @NAME@.h says; elsewhere @NAME@_start with its state.
    while (@NAME@_init(&state) != @BIG@_OK) { // compiled with flags that change results: the motors stay off
    }
    @NAME@_step(&state, &@NAME@_defaults, &input, &output); // without a measurement: the input before the first
    due_us = micros();
}

void loop()
{
    if ((long)(micros() - due_us) < 0) {
        return;
    }
    due_us += PERIOD_US;
    // A period that was missed is made up for without a measurement: it is predicted over.
    const bool missed = (long)(micros() - due_us) >= 0;
    input.measured = (!missed && read_sensors(input.y)) ? 1 : 0;
    read_command(input.r, output.path_rate);
    if (@BIG@_LATENCY > 0) { // the input of the sample before acts from here on; further samples are the drive's
        drive_motors(output.u);
    }
    const int code = @NAME@_step(&state, &@NAME@_defaults, &input, &output);
    if (@BIG@_LATENCY == 0) {
        drive_motors(output.u);
    }
    watch(code);
}

static void watch(int code)
{
    (void)code; // brakes as README.md says under "What a step returns"
}

static bool read_sensors(@NAME@_real *y)
{
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        y[i] = 0; // an encoder, in the unit of @NAME@.h
    }
    return true;
}

// The command path_rate periods further along its path@THEN_SLOWED@: less than one where the controller brakes.
// Here it rests.
static void read_command(@NAME@_real *r, @NAME@_real path_rate)
{
    static const @NAME@_real home[] = {@HOME@}; // @HOME_TEXT@, where @NAME@_init believes the robot
    (void)path_rate;
    @STANDSTILL@
}

static void drive_motors(const @NAME@_real *u)
{
    (void)u; // a PWM or a current controller
}
