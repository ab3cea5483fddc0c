/* @{name}_follow: trajectories of waypoints for @{name}, made by flexhinf @{version}. SPDX-License-Identifier: 0BSD
 *
 * Joints, in this order: @{joints | join(', ') | comment}. Positions of the links in rad (m), velocities in rad/s (m/s),
 * times in s.
 *
 * A goal has waypoints with times. Between two of them the path is linear, cubic or quintic, as both state positions
 * alone, velocities too, or accelerations too. It is smoothed, so that the links are @{delay} s later than the
 * trajectory, and stop @{twice} s after its end. Each step gives the row that @{name}_step takes as input.r: state and
 * input of the elastic arm on that motion. No memory is allocated; a step passes at most @{passed} waypoints.
 */
{% set guard = NAME ~ "_FOLLOW_H" %}
{% include "guard.h" %}

#include "@{name}.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    @{NAME}_FOLLOW_JOINTS = @{count},
    @{NAME}_FOLLOW_SAMPLES = @{size}, /* of the path, which are smoothed */
    @{NAME}_FOLLOW_DELAYED = @{latency + 1},
    @{NAME}_FOLLOW_ENDS = @{ends} /* goals that end in one call, at most */
};

/* How a goal ends, or why it is refused: the numbers of control_msgs/FollowJointTrajectory. */
enum {
    @{NAME}_FOLLOW_SUCCESSFUL = 0,
    @{NAME}_FOLLOW_INVALID_GOAL = -1,
    @{NAME}_FOLLOW_INVALID_JOINTS = -2,
    @{NAME}_FOLLOW_OLD_HEADER_TIMESTAMP = -3,
    @{NAME}_FOLLOW_PATH_TOLERANCE_VIOLATED = -4,
    @{NAME}_FOLLOW_GOAL_TOLERANCE_VIOLATED = -5,
    @{NAME}_FOLLOW_ACTIVE = 1, /* a goal is followed */
    @{NAME}_FOLLOW_IDLE = 2    /* there is none: the last pose is held */
};

/* Why, beside the code: another goal has replaced it; it was cancelled; the controller has braked its path; or it waited,
 * and the goal before it was cancelled or left its path. */
enum {
    @{NAME}_FOLLOW_BY_CODE = 0,
    @{NAME}_FOLLOW_REPLACED = 1,
    @{NAME}_FOLLOW_CANCELLED = 2,
    @{NAME}_FOLLOW_BRAKED = 3,
    @{NAME}_FOLLOW_DROPPED = 4
};

{% for record in records %}
@{record}

{% endfor %}
extern const @{name}_follow_options @{name}_follow_defaults;

/* Pointers lead to objects of the caller. None is checked, and none may be null but the points of a goal without any.
 *
 * Rest at link positions q, without a goal. Returns @{NAME}_OK; @{NAME}_BAD_COMMAND where a number is not finite; or
 * @{NAME}_BAD_ARITHMETIC where a flag of the compiler changes what is computed. */
int @{name}_follow_init(@{name}_follow_state *state, const @{name}_real *q);

/* Whether a goal may be followed: @{NAME}_FOLLOW_SUCCESSFUL, or why not. Its time grows with the waypoints, so call it
 * outside of the loop. Refused are: no waypoint; times that do not increase, or are nearer than a period / @{passed}; numbers
 * that are not finite; a joint that leaves its range at a waypoint or between two of them, or is faster there than its
 * speed limit, but for a jump of what that moves in @{smoothing} s;
{% if limited %}
 * commands that change faster, or are accelerated more, than by @{share} of what the drives take;
{% endif %}
 * a speed at the end; a joint that is left out, without the option; and a trajectory that is over. */
int @{name}_follow_check(const @{name}_follow_options *options, const @{name}_follow_goal *goal);

/* Follow a checked goal, from the motion that there is to the first waypoint whose time is still to come. Where it begins
 * later, the goal before it goes on until then, but for @{delay} s: so the links are in time. Returns @{NAME}_FOLLOW_ACTIVE;
 * or @{NAME}_FOLLOW_INVALID_GOAL where a joint would leave its range or its speed limit on the way there@{", or hurry its drive" if limited}:
 * then all goes on as before. A goal that is replaced ends when the new one is followed. */
int @{name}_follow_start(@{name}_follow_state *state, const @{name}_follow_options *options,
                        const @{name}_follow_goal *goal);

/* Come to rest within options->stop_time, whatever the speed, in the direction of the motion, and hold; sooner where a
 * joint's range ends. A goal that waits is dropped. A stop that has begun goes on as it is. Of a goal with a number that
 * one alone may be cancelled: nothing happens where it is over, and where it waits it is dropped. */
void @{name}_follow_cancel(@{name}_follow_state *state, const @{name}_follow_options *options);
void @{name}_follow_cancel_goal(@{name}_follow_state *state, const @{name}_follow_options *options, long number);

/* End every goal with a code and a reason; the motion goes on as it is, until another goal, a cancel or an init. */
void @{name}_follow_end_all(@{name}_follow_state *state, int code, int reason);

/* One sample, before @{name}_step. Returns output->result. */
int @{name}_follow_step(@{name}_follow_state *state, const @{name}_follow_options *options, const @{name}_param *param,
                       const @{name}_follow_input *input, @{name}_follow_output *output);

/* Whether a row that comes from elsewhere can be: finite; no joint out of its range, faster than its speed limit, or
 * jumping from the row a period before by more than smoothing would take; and no spring twisted, beyond its twist at
 * rest, by more than the largest input can. Returns @{NAME}_OK or @{NAME}_BAD_COMMAND. */
int @{name}_follow_row(const @{name}_param *param, const @{name}_real *before, const @{name}_real *r);

/* As @{name}_follow_row, for rows that come one behind another, so many periods later: their jumps together are no more
 * than smoothing would take, beside the speed limit. spent has a number for each joint, 0 at first, and keeps that. */
int @{name}_follow_stream(const @{name}_param *param, @{name}_real *spent, long periods, const @{name}_real *before, const @{name}_real *r);

#ifdef __cplusplus
}
#endif

#endif
