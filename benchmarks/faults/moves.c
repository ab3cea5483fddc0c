#include "bench.h"

#include <math.h>
#include <string.h>

/* Goals stay this fraction of a joint's range inside of it. */
static const double INSIDE = 0.05;
/* Longest move at full speed, s, and rest between two. */
static const double LONGEST = 1.2, SHORTEST_REST = 0.05, LONGEST_REST = 0.3;
/* Peak velocity and acceleration of the quintic from rest to rest, over distance and time. */
static const double VELOCITY_PEAK = 1.875, ACCELERATION_PEAK = 5.7735;
/* Time, s, in which a joint may reach its speed limit: that of the governor. */
static const double QUICKEST = 0.3;
/* Largest share of a drive's torque that a move may need; the rest is for feedback, noise and tolerances. */
static const double SHARE = 0.7;
/* Instants of a move at which its torques are looked at, and how much slower it becomes where they are too large. */
enum { LOOKS = 12, TRIES = 12 };
static const double SLOWER = 1.2;
/* A command stands at its goal within this, rad and rad/s. */
static const double THERE = 1e-4;

void moves_begin(bench *b, const double *q)
{
    arm_real at[MOST];
    for (int i = 0; i < NOMINAL.n; ++i) { at[i] = (arm_real)q[i]; }
    (void)arm_follow_init(&b->follow, at);
    for (int i = 0; i < NOMINAL.n; ++i) { b->row.position[i] = at[i]; }
    b->row.result = ARM_FOLLOW_IDLE;
    b->rests_until = LONGEST_REST;
}

/* Whether the drives of the nominal robot, with its largest payload, make the move from a to b in a time. */
static int can(const double *from, const double *to, double time)
{
    plant p;
    memset(&p, 0, sizeof p);
    p.model = NOMINAL;
    plant_carry(&p, HIGHEST.is.payload);
    for (int k = 0; k <= LOOKS; ++k) {
        const double s = (double)k / LOOKS;
        double q[MOST], v[MOST], a[MOST], torque[MOST];
        for (int i = 0; i < NOMINAL.n; ++i) {
            const double d = to[i] - from[i];
            q[i] = from[i] + d * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
            v[i] = d / time * 30.0 * s * s * (1.0 - s) * (1.0 - s);
            a[i] = d / (time * time) * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s);
        }
        plant_torques(&p, q, v, a, torque);
        for (int i = 0; i < NOMINAL.n; ++i) {
            const plant_numbers *is = &NOMINAL.is;
            const double needed = torque[i] + is->motor_inertia[i] * a[i] + is->friction[i] * v[i] +
                                  copysign(is->coulomb[i], v[i]);
            const double u = plant_command(&NOMINAL, i, needed, q[i], v[i]);
            const int looped = NOMINAL.drive == VELOCITY || NOMINAL.drive == POSITION;
            if (looped ? fabs(needed) > SHARE * is->largest[i] : fabs(u) > SHARE * is->effort_limit[i]) { return 0; }
        }
    }
    return 1;
}

/* The next goal: random, within the ranges, as quick as speeds and drives allow. */
static void next_goal(bench *b)
{
    const plant_numbers *is = &NOMINAL.is;
    double from[MOST], to[MOST], time = 0.1;
    arm_follow_goal goal;
    memset(&goal, 0, sizeof goal);
    for (int i = 0; i < NOMINAL.n; ++i) {
        const double most = LONGEST * b->asked.speed * is->speed_limit[i] / VELOCITY_PEAK;
        const double room = fmin(INSIDE * (is->upper[i] - is->lower[i]), 1.0);
        from[i] = (double)b->row.position[i];
        to[i] = from[i] + most * (2.0 * uniform(b, OF_MOVES) - 1.0);
        to[i] = fmin(fmax(to[i], is->lower[i] + room), is->upper[i] - room);
        const double d = fabs(to[i] - from[i]), v = b->asked.speed * is->speed_limit[i];
        time = fmax(time, fmax(VELOCITY_PEAK * d / v, sqrt(ACCELERATION_PEAK * d * QUICKEST / v)));
        b->point.position[i] = (arm_real)to[i];
        b->point.velocity[i] = b->point.acceleration[i] = 0;
        goal.moves[i] = 1;
    }
    b->point.order = 3;
    goal.points = &b->point;
    goal.count = 1;
    for (int k = 0; k < TRIES; ++k) {
        if (can(from, to, time)) {
            b->point.time = (arm_real)(1.0001 * time); /* a rounded time must not make it faster than the limit */
            if (arm_follow_check(&arm_follow_defaults, &goal) == ARM_FOLLOW_SUCCESSFUL) { break; }
        }
        time *= SLOWER;
    }
    if (arm_follow_start(&b->follow, &arm_follow_defaults, &goal) == ARM_FOLLOW_ACTIVE) {
        b->active = 1;
        ++b->found.moves;
    }
}

/* Whether the command stands at its goal. The arm's own arrival is no measure: the velocity that is estimated at rest
 * may stay beyond the tolerance of the goal, where a spring is softer than the nominal one. */
static int arrived(const bench *b)
{
    for (int i = 0; i < NOMINAL.n; ++i) {
        const double left = fabs((double)(b->row.position[i] - b->point.position[i]));
        if (left > THERE || fabs((double)b->row.velocity[i]) > THERE) { return 0; }
    }
    return 1;
}

void moves_step(bench *b)
{
    arm_follow_input in;
    const int counted = b->asked.moves > 0;
    const int more = counted ? b->found.moves < b->asked.moves : b->t < b->asked.at + b->asked.lasts - 2.0 * LONGEST;
    memset(&in, 0, sizeof in);
    if (!b->active && more && !b->found.noticed && b->t >= b->rests_until) { next_goal(b); }
    for (int i = 0; i < NOMINAL.n; ++i) {
        in.position[i] = b->output.estimate[i];
        in.velocity[i] = b->output.estimate[NOMINAL.n + i];
    }
    in.speed = 1;
    in.path_rate = b->output.path_rate;
    (void)arm_follow_step(&b->follow, &arm_follow_defaults, &arm_defaults, &in, &b->row);
    if (b->active && arrived(b)) {
        b->active = 0;
        b->rests_until = b->t + SHORTEST_REST + (LONGEST_REST - SHORTEST_REST) * uniform(b, OF_MOVES);
    }
    memcpy(b->input.r, b->row.r, sizeof b->input.r);
}
