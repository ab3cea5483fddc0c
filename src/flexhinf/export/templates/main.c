{% import "drives.c" as drives with context %}
/* How @{name} is used: one call before the loop, one call in it. The functions of your board are yours. */
#include "@{name}{% if follows %}_follow{% endif %}.h"

#include <string.h>

/* Of your board. Elements of the arrays have names in @{name}.h, such as those that begin with @{NAME}_Y_. */
extern void wait_for_sample(void);
extern int drives_enabled(void); /* 0 while the motors have no power, or the brakes of the robot are closed */
extern int read_sensors(@{name}_real *y); /* 0 where there was no measurement in time */
{% if follows %}
extern int read_goal(@{name}_follow_goal *goal); /* 1: a new one, which @{name}_follow_check took outside of the loop, and whose points stay as they are; -1: all come to rest; 0: neither */
extern void goal_ended(const @{name}_follow_end *end, int status); /* how a goal with a number ended, and bits of output.status then; @{NAME}_FOLLOW_BRAKED too where drives are off or stop */
{% else %}
extern void read_command(@{name}_real *r, @{name}_real path_rate); /* path_rate periods further along its path{% if code.slows %}, and where that is below 1, @{name}_slowed{% endif %} */
{% endif %}
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

{% if follows %}
static @{name}_follow_state path; /* of the command */

/* Tell of the goals that the last call for the path ended. */
static void tell(int status)
{
    for (int i = 0; i < path.ended; ++i) {
        goal_ended(&path.ends[i], status);
    }
    path.ended = 0;
}

/* End all goals, as drives are off or stop. */
static void leave(int status)
{
    @{name}_follow_end_all(&path, @{NAME}_FOLLOW_PATH_TOLERANCE_VIOLATED, @{NAME}_FOLLOW_BRAKED);
    tell(status);
}

/* The command of a sample, along the goals that come: tolerances are judged by the estimate, and the path goes on as fast as
 * the controller lets it. */
static void follow(int enabled, const @{name}_output *last, @{name}_real *r)
{
    @{name}_follow_goal goal = {0};
    @{name}_follow_input now = {0};
    @{name}_follow_output next;
    const int asked = read_goal(&goal);
    if (asked > 0) {
        @{name}_follow_end end = {0};
        end.number = goal.number;
        end.code = @{NAME}_FOLLOW_INVALID_GOAL; /* of drives that are off or stop */
        if (enabled != 0 && last->stop == 0) {
            end.code = @{name}_follow_start(&path, &@{name}_follow_defaults, &goal);
        }
        tell(last->status);
        if (end.code != @{NAME}_FOLLOW_ACTIVE && end.number != 0) {
            goal_ended(&end, last->status);
        }
    } else if (asked < 0) {
        @{name}_follow_cancel(&path, &@{name}_follow_defaults);
        tell(last->status);
    } else {
        /* what there is goes on */
    }
    for (int j = 0; j < @{NAME}_FOLLOW_JOINTS; ++j) {
        now.position[j] = last->estimate[j];
        now.velocity[j] = last->estimate[@{NAME}_FOLLOW_JOINTS + j];
    }
    now.speed = 1; /* below it, goals are followed more slowly */
    now.path_rate = last->path_rate;
    (void)@{name}_follow_step(&path, &@{name}_follow_defaults, &@{name}_defaults, &now, &next);
    tell(last->status);
    for (int i = 0; i < @{NAME}_COMMANDS; ++i) {
        r[i] = next.r[i];
    }
}

{% endif %}
int main(void)
{
    @{name}_input input = {0};
    @{name}_output output = {0};
    int enabled = @{NAME}_ENABLED;
    int acts = 1; /* once 0 it stays so: look at the robot, then begin again with @{name}_start */
    const int begun = begin_with(&state);
    if (begun != @{NAME}_OK{% if follows %} || @{name}_follow_init(&path, home) != @{NAME}_OK{% endif %}) { /* two exports, or compiled with flags that change results */
        brake(@{NAME}_STOP_STEP_FAILED);
        return 1;
    }
    @{drives.rest_at_home("input.r")} /* the command until there is another */
    @{name}_step(&state, &@{name}_defaults, &input, &output); /* without a measurement: the input before the first */
    while (acts) {
        int code;
{% if follows %}
        const int before = enabled;
{% endif %}
        wait_for_sample();
        input.measured = read_sensors(input.y);
        enabled = still_enabled(enabled, &input, &output);
{% if follows %}
        if (enabled == 0) {
            leave(output.status);
        } else if (before == 0) { /* it rests there */
            (void)@{name}_follow_init(&path, input.r);
        } else {
            /* it goes on */
        }
        follow(enabled, &output, input.r);
{% else %}
        read_command(input.r, output.path_rate);
{% endif %}
        if (@{NAME}_LATENCY > 0) { /* the input of the sample before acts from here on; further samples are the drive's */
            drive_motors(output.u);
        }
        input.elapsed = seconds_since_sample();
        code = @{name}_step(&state, &@{name}_defaults, &input, &output);
        report(code);
        acts = (is_heard(enabled, &output) != 0) ? @{name}_may_act(&state, &@{name}_defaults, code, &output) : 1; /* a controlled stop has an output.u of its own */
{% if follows %}
        if (output.stop != 0) {
            leave(output.status);
        }
{% endif %}
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
