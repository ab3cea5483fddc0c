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
    @{NAME}_FOLLOW_SAMPLES = @{size} /* of the path, which are smoothed */
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

typedef struct {
    @{name}_real time; /* from the beginning of the trajectory */
    @{name}_real position[@{NAME}_FOLLOW_JOINTS], velocity[@{NAME}_FOLLOW_JOINTS], acceleration[@{NAME}_FOLLOW_JOINTS];
    int order; /* 1: positions alone; 2: velocities too; 3: accelerations too */
} @{name}_follow_point;

/* Of a goal: 0 is what the options have, -1 is any difference. Of the options: 0 is any difference. */
typedef struct {
    @{name}_real position[@{NAME}_FOLLOW_JOINTS], velocity[@{NAME}_FOLLOW_JOINTS];
} @{name}_follow_tolerance;

typedef struct {
    const @{name}_follow_point *points; /* they must stay where they are until another goal is followed */
    int count;
    int moves[@{NAME}_FOLLOW_JOINTS]; /* 0: a joint that the goal leaves out; its numbers are not read */
    @{name}_real begins;              /* from now until the trajectory begins; below 0: since then */
    @{name}_follow_tolerance path, goal;
    @{name}_real goal_time; /* after the end of the path, in which the goal must be reached; 0 and -1 as above */
} @{name}_follow_goal;

typedef struct {
    @{name}_follow_tolerance path, goal;
    @{name}_real goal_time; /* 0: any */
    @{name}_real timeout;   /* after the end of a path, after which its goal is given up; 0: none */
    @{name}_real stop_time; /* in which joints come to rest after a cancelled goal, or that a goal leaves out */
    int partial;            /* whether a goal may leave joints out */
{% if limited %}
    int limited;            /* whether a goal that is too quick for the drives is refused */
{% endif %}
} @{name}_follow_options;

extern const @{name}_follow_options @{name}_follow_defaults;

typedef struct {
    @{name}_real position[@{NAME}_FOLLOW_JOINTS], velocity[@{NAME}_FOLLOW_JOINTS]; /* as output.estimate of the last step */
    @{name}_real speed;     /* fraction of its speed with which a trajectory is followed, 0 to 1; at once at rest */
    @{name}_real path_rate; /* output.path_rate of the last @{name}_step; 1 before it */
} @{name}_follow_input;

typedef struct {
    @{name}_real r[@{NAME}_COMMANDS];
    @{name}_real position[@{NAME}_FOLLOW_JOINTS], velocity[@{NAME}_FOLLOW_JOINTS]; /* where the links are to be now */
    int waits;  /* whether a goal waits until it begins; the one before is still followed */
    int result; /* @{NAME}_FOLLOW_ACTIVE, _IDLE, or in one sample how the goal ended */
} @{name}_follow_output;

/* What is remembered between samples. Its parts are not for the caller. */
typedef struct {
    @{name}_real path[@{NAME}_FOLLOW_SAMPLES][@{NAME}_FOLLOW_JOINTS];
    @{name}_real motion[2][5][@{NAME}_FOLLOW_JOINTS], part;
    @{name}_real before[@{latency + 1}][2][@{NAME}_FOLLOW_JOINTS];
    @{name}_real now[3][@{NAME}_FOLLOW_JOINTS], from[3][@{NAME}_FOLLOW_JOINTS];
    @{name}_real speed, since, first, age, stop_time, stopped_at;
    @{name}_follow_goal goal, next;
    long wait, ended; /* samples */
    int newest, has_next, active, segment, left;
} @{name}_follow_state;

/* Pointers lead to objects of the caller. None is checked, and none may be null but the points of a goal without any.
 *
 * Rest at link positions q, without a goal. Returns @{NAME}_OK; @{NAME}_BAD_COMMAND where a number is not finite; or
 * @{NAME}_BAD_ARITHMETIC where a flag of the compiler changes what is computed. */
int @{name}_follow_init(@{name}_follow_state *state, const @{name}_real *q);

/* Whether a goal may be followed: @{NAME}_FOLLOW_SUCCESSFUL, or why not. Its time grows with the waypoints, so call it
 * outside of the loop. Refused are: no waypoint; times that do not increase, or are nearer than a period / @{passed}; numbers
 * that are not finite; a place outside of the joint's range; a jump, or a way that is faster than the joint's speed limit;
{% if limited %}
 * commands that change faster, or are accelerated more, than by @{share} of what the drives take;
{% endif %}
 * a speed at the end; a joint that is left out, without the option; and a trajectory that is over. */
int @{name}_follow_check(const @{name}_follow_options *options, const @{name}_follow_goal *goal);

/* Follow a checked goal, from the motion that there is to the first waypoint whose time is still to come. Where it begins
 * later, the goal before it goes on until then, but for @{delay} s: so the links are in time. Returns @{NAME}_FOLLOW_ACTIVE;
 * or @{NAME}_FOLLOW_INVALID_GOAL where that would be a jump@{", or too quick for a drive" if limited}: then all goes on as before. */
int @{name}_follow_start(@{name}_follow_state *state, const @{name}_follow_options *options,
                        const @{name}_follow_goal *goal);

/* Come to rest within options->stop_time, whatever the speed, in the direction of the motion, and hold; sooner where a
 * joint's range ends. A goal that waits is dropped. A stop that has begun goes on as it is. */
void @{name}_follow_cancel(@{name}_follow_state *state, const @{name}_follow_options *options);

/* One sample, before @{name}_step. Returns output->result. */
int @{name}_follow_step(@{name}_follow_state *state, const @{name}_follow_options *options, const @{name}_param *param,
                       const @{name}_follow_input *input, @{name}_follow_output *output);

/* Whether a row that comes from elsewhere can be: finite; no joint jumps from the row before by more than smoothing would
 * take; and no spring is twisted, beyond its twist at rest, by more than the largest input can. Returns @{NAME}_OK or
 * @{NAME}_BAD_COMMAND. */
int @{name}_follow_row(const @{name}_param *param, const @{name}_real *before, const @{name}_real *r);

#ifdef __cplusplus
}
#endif

#endif
