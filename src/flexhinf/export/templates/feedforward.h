/* @{name}: commands for the drives of @{robot | comment} along a streamed path. flexhinf @{version}.
 *
 * Joints: @{joints | join(', ') | comment}. One step each @{period} s.
 * The links follow the path @{delay} s later@{", and half a period of each vibration, for which it is shaped" if shaper}.
 * Positions are in rad (m), velocities in rad/s (m/s), torques in N·m (N), all seen from the link.
 */
{% set guard = NAME ~ "_H" %}
{% include "guard.h" %}

#define @{NAME}_JOINTS @{count}
#define @{NAME}_SAMPLES @{size}
{% if shaper %}
#define @{NAME}_VIBRATIONS @{vibrations}
#define @{NAME}_KEPT @{kept} /* samples, for the longest period of a vibration */
{% endif %}

typedef struct {
    double path[@{NAME}_SAMPLES][@{NAME}_JOINTS]; /* the last samples of the path */
    int newest;
{% if shaper %}
    double streamed[@{NAME}_JOINTS]; /* the last sample before it is shaped, and what its two passes keep */
    double first_pass[@{NAME}_VIBRATIONS][@{NAME}_KEPT][@{NAME}_JOINTS];
    double second_pass[@{NAME}_VIBRATIONS][@{NAME}_KEPT][@{NAME}_JOINTS];
    int latest;
{% endif %}
{% if limited %}
    double command[@{NAME}_JOINTS]; /* the last one, and its rate, where there were some */
    double rate[@{NAME}_JOINTS];
    int moved;
{% endif %}
} @{name}_state;

typedef struct {
    double command[@{NAME}_JOINTS]; /* input of the drives: @{kind} */
    double motor_position[@{NAME}_JOINTS]; /* or a target position with two offsets: */
    double motor_velocity[@{NAME}_JOINTS]; /* velocity offset, 0x60B1 */
    double motor_torque[@{NAME}_JOINTS]; /* torque offset, 0x60B2 */
} @{name}_output;

/* Rest at a path's first sample. Returns 0; or 1 where the compiler's flags change what is computed. */
int @{name}_init(@{name}_state *state, const double *path);

/* Take the next sample of the path. Returns 0; or 1 where a number is not finite: the path then stays where it was.
{% if limited %}
 * 2 is added where a command is larger, changes faster or is accelerated more than its drive takes, or the torque of a
 * motor is larger: it is given all the same.
{% endif %}
{% if shaper %}
 * 4 is added where a vibration is slower than @{NAME}_KEPT samples, or the springs do not hold the links: the shaper's
 * delay is then that of @{NAME}_KEPT samples.
{% endif %}
 */
int @{name}_step(@{name}_state *state, const double *path, @{name}_output *output);

#endif
