/* Arms that a page moves: each is the plant with its own numbers, stepped by the exported controller or by a PD on its
 * motors. Made by flexhinf @{version}; not to be edited.
 *
 * Arm 0 has the controller, arm 1 the PD; arms 2k and 2k + 1 are the perturbed pair number k with the same numbers. */
#include "@{name}.h"

#include <math.h>
#include <stdbool.h>

{% with name = "plant", NAME = "PLANT" %}
{% include "arithmetic.c" %}
{% endwith %}

#define FMA(a, b, c) ((a) * (b) + (c))
#define EXPORT(name) __attribute__((export_name(#name))) name

typedef double real;

enum {
    STATES = @{n},
    INPUTS = @{m},
    DISTURBANCES = @{d},
    PARAMETERS = @{p},
    MEASURED = @{y},
    COMMANDS = @{r},
    JOINTS = @{q},
    NUMBERS = @{v},
    PAIRS = @{pairs},
    QUEUE = @{queue}, /* largest latency, samples */
    LATENCY = @{latency}, /* samples that the controller knows of */
    POSE = 15 * JOINTS /* of each link: rotation by rows, origin, axis of its joint, in the world */
};

static const double period = @{period};

@{functions}
/* What one arm is. */
typedef struct {
    double x[STATES], p[PARAMETERS], numbers[NUMBERS], y[MEASURED], u[INPUTS], output[INPUTS];
    double waiting[(QUEUE + 1) * INPUTS];
    double seen[JOINTS], rate[JOINTS]; /* what the PD has of the motors: positions, and their filtered rates */
    unsigned long long random;
    int next, code, status, lost;
} arm;

static arm arms[2 * (PAIRS + 1)];
static @{name}_state controllers[PAIRS + 1];

/* What the page sets, and what it reads. */
static double noise[MEASURED] = {@{noise}}, motor_noise[JOINTS] = {@{motor_noise}};
static double lower[INPUTS] = {@{lower}}, upper[INPUTS] = {@{upper}};
static double nominal[PARAMETERS], torque[JOINTS], pushed[JOINTS], pulled[JOINTS], force[3];
static double noise_factor = 0.0;
/* Of the tuned PD, then of the stiff one. */
static const double gain[2][2 * JOINTS] = {{@{gain}}, {@{stiff_gain}}}, cutoff[2][JOINTS] = {{@{cutoff}}, {@{stiff_cutoff}}};
static int stiff = 0;
static int latency = LATENCY, sensing = 1, sub_steps = 1, ghost_sub_steps = 1;

/* Where each command comes from: an element of the wanted state and, behind it, of the wanted input. */
static const int command_of[COMMANDS ? COMMANDS : 1] = {@{command_of}};
/* Dry friction that both controllers overcome: its level, smoothing speed, level at rest, and speed of its fall. */
static const double dry[4 * JOINTS] = {@{dry}};
/* The state that each joint's motor position and speed are; of a rigid joint those of its link. */
static const int motor_of[2 * JOINTS] = {@{motor_of}};
/* What each motor adds to where a link would be without twist: rows of the inverse of the coupling. */
static const double back[JOINTS * JOINTS] = {@{back}};

/* A motion of the command: one polynomial of degree five in each joint, from a position, speed and acceleration. */
typedef struct {
    double from[3 * JOINTS], goal[JOINTS], time, length;
} motion;

/* That of the controller, and that of the PD. */
static motion motions[2];
static double wanted[JOINTS];

static double scratch[POSE + 2 * STATES + 64];

/* Random numbers: xorshift*, and a normal number from two uniform ones. */
static double uniform(arm *a)
{
    a->random ^= a->random >> 12;
    a->random ^= a->random << 25;
    a->random ^= a->random >> 27;
    return ((double)((a->random * 2685821657736338717ULL) >> 11) + 0.5) / 9007199254740992.0;
}

static double normal(arm *a)
{
    const double radius = sqrt(-2.0 * log(uniform(a)));
    return radius * cos(6.283185307179586 * uniform(a));
}

/* Command ------------------------------------------------------------------------------------------ */
/* Position and four derivatives of one joint at a time after the beginning of the motion. */
static void polynomial(const motion *m, int joint, double at, double *derivatives)
{
    const double t = at < 0.0 ? 0.0 : at, T = m->length;
    const double q = m->from[joint], v = m->from[JOINTS + joint], a = m->from[2 * JOINTS + joint];
    for (int k = 0; k < 5; ++k) {
        derivatives[k] = 0.0;
    }
    if (t >= T) {
        derivatives[0] = m->goal[joint];
        return;
    }
    {
        const double left = m->goal[joint] - q - v * T - 0.5 * a * T * T;
        const double speed = -(v + a * T) * T, bend = -a * T * T;
        const double c3 = (10.0 * left - 4.0 * speed + 0.5 * bend) / (T * T * T);
        const double c4 = (-15.0 * left + 7.0 * speed - bend) / (T * T * T * T);
        const double c5 = (6.0 * left - 3.0 * speed + 0.5 * bend) / (T * T * T * T * T);
        derivatives[0] = q + t * (v + t * (0.5 * a + t * (c3 + t * (c4 + t * c5))));
        derivatives[1] = v + t * (a + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)));
        derivatives[2] = a + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5));
        derivatives[3] = 6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5);
        derivatives[4] = 24.0 * c4 + t * 120.0 * c5;
    }
}

/* State, then input, at rest at link positions (q), by an arm's parameters (p). */
static void resting(const double *q, const double *p, double *xu)
{
    @{standstill}
}

/* State and input on the way, by the nominal arm; at rest the equilibrium. */
static void desired(const motion *m, double *xu)
{
    const double at = m->time + LATENCY * period;
    double d[5], parts[5][JOINTS];
    for (int i = 0; i < JOINTS; ++i) {
        polynomial(m, i, at, d);
        for (int k = 0; k < 5; ++k) {
            parts[k][i] = d[k];
        }
    }
    if (at >= m->length) {
        resting(parts[0], nominal, xu);
    } else {
        @{inverse}
    }
}

/* The same as a stiff PD knows it: at rest at each place of the way, with the motors' speeds along it. */
static void held_weight(const motion *m, double *xu)
{
    const double at = m->time + LATENCY * period;
    double d[5], places[JOINTS], last[JOINTS], before[STATES + INPUTS];
    for (int i = 0; i < JOINTS; ++i) {
        polynomial(m, i, at, d);
        places[i] = d[0];
        polynomial(m, i, at - period, d);
        last[i] = d[0];
    }
    resting(last, nominal, before);
    resting(places, nominal, xu);
    for (int i = 0; i < JOINTS; ++i) {
        xu[motor_of[JOINTS + i]] = (xu[motor_of[i]] - before[motor_of[i]]) / period;
    }
}

/* The plant ---------------------------------------------------------------------------------------- */
static void integrate(arm *a, const double *d, int steps)
{
    const double h = period / steps;
    static const double share[3] = {0.5, 0.5, 1.0};
    double slope[4][STATES], at[STATES], *x = a->x;
    for (int k = 0; k < steps; ++k) {
        @{flow_x}
        for (int stage = 1; stage < 4; ++stage) {
            for (int i = 0; i < STATES; ++i) {
                at[i] = x[i] + share[stage - 1] * h * slope[stage - 1][i];
            }
            @{flow_at}
        }
        for (int i = 0; i < STATES; ++i) {
            x[i] += h / 6.0 * (slope[0][i] + 2.0 * (slope[1][i] + slope[2][i]) + slope[3][i]);
        }
    }
    for (int i = 0; i < STATES; ++i) {
        if (!(fabs(x[i]) < 1e4)) {
            a->lost = 1;
        }
    }
}

static void measure(arm *a)
{
    @{output}
    for (int i = 0; i < MEASURED; ++i) {
        a->y[i] += noise_factor > 0.0 ? noise_factor * noise[i] * normal(a) : 0.0;
    }
}

static void controlled(arm *a, @{name}_state *state, const double *r)
{
    @{name}_input in = {0};
    @{name}_output out;
    for (int i = 0; i < MEASURED; ++i) {
        in.y[i] = a->y[i];
    }
    for (int i = 0; i < COMMANDS; ++i) {
        in.r[i] = r[i];
    }
    in.measured = sensing;
    a->code = @{name}_step(state, &@{name}_defaults, &in, &out);
    a->status = out.status;
    for (int i = 0; i < INPUTS; ++i) {
        a->output[i] = out.u[i];
    }
}

/* What dry friction takes of an input at a commanded speed, as in the controller. */
static double overcome(int i, double speed)
{
    const double *level = dry, *smoothing = dry + JOINTS, *most = dry + 2 * JOINTS, *slow = dry + 3 * JOINTS;
    const double ratio = @{sharpness} * speed / smoothing[i], share = speed / slow[i];
    return (level[i] + (most[i] - level[i]) * exp(-(share * share))) * tanh(ratio * ratio * ratio);
}

/* u = u_d - Kp (theta - theta_d) - Kd (rate - rate_d), within the limits; the rate is a filtered difference. */
static void by_pd(arm *a, const double *xu)
{
    const double *kp = gain[stiff], *kd = gain[stiff] + JOINTS;
    for (int i = 0; i < JOINTS && sensing; ++i) {
        const double sensed = noise_factor > 0.0 ? noise_factor * motor_noise[i] * normal(a) : 0.0;
        const double theta = a->x[motor_of[i]] + sensed;
        const double aim = xu[motor_of[i]], speed = xu[motor_of[JOINTS + i]];
        double u;
        a->rate[i] += (1.0 - exp(-cutoff[stiff][i] * period)) * ((theta - a->seen[i]) / period - a->rate[i]);
        a->seen[i] = theta;
        u = xu[STATES + i] + overcome(i, speed) - kp[i] * (theta - aim) - kd[i] * (a->rate[i] - speed);
        a->output[i] = u < lower[i] ? lower[i] : u > upper[i] ? upper[i] : u;
    }
}

static void delayed(arm *a, int late)
{
    double *place = a->waiting + a->next * INPUTS;
    const int read = (a->next + QUEUE + 1 - late) % (QUEUE + 1);
    for (int i = 0; i < INPUTS; ++i) {
        place[i] = a->output[i];
    }
    for (int i = 0; i < INPUTS; ++i) {
        a->u[i] = a->waiting[read * INPUTS + i];
    }
    a->next = (a->next + 1) % (QUEUE + 1);
}

/* The hand that pulls ------------------------------------------------------------------------------ */
static int held_link = -1;
static double held_at[3], hand[3], softness = 1.0, strongest = 1.0;
static const int parent_of[JOINTS] = {@{parents}}, slides[JOINTS] = {@{slides}};

void EXPORT(pose_of)(const double *q, double *out)
{
    @{frames}
}

static void pull(void)
{
    double frames[POSE], point[3], size = 0.0;
    for (int i = 0; i < JOINTS; ++i) {
        pulled[i] = 0.0;
    }
    for (int k = 0; k < 3; ++k) {
        force[k] = 0.0;
    }
    if (held_link < 0) {
        return;
    }
    pose_of(arms[0].x, frames);
    for (int k = 0; k < 3; ++k) {
        const double *turn = frames + 15 * held_link;
        point[k] = turn[9 + k];
        for (int l = 0; l < 3; ++l) {
            point[k] += turn[3 * k + l] * held_at[l];
        }
        force[k] = softness * (hand[k] - point[k]);
        size += force[k] * force[k];
    }
    size = sqrt(size);
    for (int k = 0; k < 3 && size > strongest; ++k) {
        force[k] *= strongest / size;
    }
    for (int i = held_link; i >= 0; i = parent_of[i]) {
        const double *origin = frames + 15 * i + 9, *axis = frames + 15 * i + 12;
        const double a = point[0] - origin[0], b = point[1] - origin[1], c = point[2] - origin[2];
        const double turning = axis[0] * (b * force[2] - c * force[1]) + axis[1] * (c * force[0] - a * force[2]) +
                               axis[2] * (a * force[1] - b * force[0]);
        const double sliding = axis[0] * force[0] + axis[1] * force[1] + axis[2] * force[2];
        pulled[i] = slides[i] ? sliding : turning;
    }
}

/* What the page calls ------------------------------------------------------------------------------ */
void EXPORT(set_numbers)(int k)
{
    arm *a = arms + k;
    @{pack}
}

/* The numbers of the model that is used for feedforward, for rest at the start, and by the PD. */
void EXPORT(set_nominal)(void)
{
    for (int i = 0; i < PARAMETERS; ++i) {
        nominal[i] = arms[0].p[i];
    }
}

/* Both commands go to the wanted positions from where they are, each in its own time, s; with 0 it jumps there. */
void EXPORT(set_motion)(double length, double length_of_pd)
{
    for (int k = 0; k < 2; ++k) {
        motion *m = motions + k;
        double d[JOINTS][5];
        for (int i = 0; i < JOINTS; ++i) {
            polynomial(m, i, m->time, d[i]);
        }
        for (int i = 0; i < JOINTS; ++i) {
            m->goal[i] = wanted[i];
            for (int order = 0; order < 3; ++order) {
                m->from[order * JOINTS + i] = d[i][order];
            }
        }
        m->time = 0.0;
        m->length = k ? length_of_pd : length;
    }
}

/* Both commands rest at the wanted positions at once. */
void EXPORT(set_command)(void)
{
    for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < JOINTS; ++i) {
            motions[k].goal[i] = motions[k].from[i] = wanted[i];
            motions[k].from[JOINTS + i] = motions[k].from[2 * JOINTS + i] = 0.0;
        }
        motions[k].time = motions[k].length = 0.0;
    }
}

/* An arm at rest where the command is. */
void EXPORT(begin)(int k, int seed)
{
    double start[STATES + INPUTS], own[STATES + INPUTS];
    arm *a = arms + k;
    resting(motions[0].goal, nominal, start);
    resting(motions[0].goal, a->p, own);
    for (int i = 0; i < STATES; ++i) {
        a->x[i] = own[i];
    }
    for (int i = 0; i < INPUTS; ++i) {
        const double u = start[STATES + i];
        a->u[i] = a->output[i] = u < lower[i] ? lower[i] : u > upper[i] ? upper[i] : u;
    }
    for (int i = 0; i < (QUEUE + 1) * INPUTS; ++i) {
        a->waiting[i] = a->u[i % INPUTS];
    }
    for (int i = 0; i < JOINTS; ++i) {
        a->seen[i] = a->x[motor_of[i]];
        a->rate[i] = 0.0;
    }
    a->random = 0x9E3779B97F4A7C15ULL * (unsigned long long)(unsigned)(seed + 1) + (unsigned)k;
    a->next = a->code = a->status = a->lost = 0;
    uniform(a);
    uniform(a);
    if (k % 2 == 0) {
        @{estimate}
        @{name}_start(controllers + k / 2, &@{name}_defaults, @{belief}, a->u);
    }
}

/* A perturbed arm goes on from where arm 0 or 1 is now, with its controller's memory, and its own numbers. */
void EXPORT(join)(int k, int seed)
{
    arm *a = arms + k;
    const arm *first = arms + k % 2;
    for (int i = 0; i < STATES; ++i) {
        a->x[i] = first->x[i];
    }
    for (int i = 0; i < INPUTS; ++i) {
        a->u[i] = first->u[i];
        a->output[i] = first->output[i];
    }
    for (int i = 0; i < (QUEUE + 1) * INPUTS; ++i) {
        a->waiting[i] = first->waiting[i];
    }
    for (int i = 0; i < JOINTS; ++i) {
        a->seen[i] = first->seen[i];
        a->rate[i] = first->rate[i];
    }
    a->random = 0x9E3779B97F4A7C15ULL * (unsigned long long)(unsigned)(seed + 1) + (unsigned)k;
    a->next = first->next;
    a->code = first->code;
    a->status = first->status;
    a->lost = first->lost;
    if (k % 2 == 0) {
        controllers[k / 2] = controllers[0];
    }
}

/* Samples of arm 0 and its ghosts (`pairs` of them), and of `pd` arms with a PD. */
void EXPORT(advance)(int samples, int pairs, int pd)
{
    double xu[2][STATES + INPUTS], r[COMMANDS ? COMMANDS : 1], d[DISTURBANCES];
    for (int s = 0; s < samples; ++s) {
        desired(motions, xu[0]);
        if (stiff) {
            held_weight(motions + 1, xu[1]);
        } else {
            desired(motions + 1, xu[1]);
        }
        for (int i = 0; i < COMMANDS; ++i) {
            r[i] = xu[0][command_of[i]];
        }
        pull();
        for (int i = 0; i < DISTURBANCES; ++i) {
            d[i] = i < JOINTS ? pulled[i] + pushed[i] : 0.0;
        }
        for (int i = 0; i < JOINTS; ++i) {
            torque[i] = d[i];
        }
        for (int k = 0; k < 2 * (pairs + 1); ++k) {
            arm *a = arms + k;
            if (a->lost || (k % 2 && k > 2 * pd - 1)) {
                continue;
            }
            if (k % 2) {
                by_pd(a, xu[1]);
            } else {
                measure(a);
                controlled(a, controllers + k / 2, r);
            }
            delayed(a, latency);
            integrate(a, d, k < 2 ? sub_steps : ghost_sub_steps);
        }
        motions[0].time += period;
        motions[1].time += period;
    }
}

/* The command's positions now. */
void EXPORT(command_now)(double *q)
{
    double d[5];
    for (int i = 0; i < JOINTS; ++i) {
        polynomial(motions, i, motions[0].time, d);
        q[i] = d[0];
    }
}

void EXPORT(motor_pose)(int k, int joint, double factor, double *out)
{
    double q[JOINTS], relaxed = 0.0;
    for (int i = 0; i < JOINTS; ++i) {
        q[i] = arms[k].x[i];
        relaxed += back[JOINTS * joint + i] * arms[k].x[motor_of[i]];
    }
    q[joint] += factor * (relaxed - q[joint]);
    pose_of(q, out);
}

void EXPORT(hold)(int link, double stiffness, double limit)
{
    held_link = link;
    softness = stiffness;
    strongest = limit;
}

void EXPORT(set_conditions)(double noise_times, int late, int sensor, int steps, int ghost_steps)
{
    noise_factor = noise_times;
    latency = late < 0 ? 0 : late > QUEUE ? QUEUE : late;
    sensing = sensor;
    sub_steps = steps;
    ghost_sub_steps = ghost_steps;
}

/* Whether the PD is the stiff one. */
void EXPORT(set_stiff)(int on) { stiff = on != 0; }

int EXPORT(code_of)(int k) { return arms[k].code; }
int EXPORT(status_of)(int k) { return arms[k].status; }
int EXPORT(lost)(int k) { return arms[k].lost; }

/* Where the numbers of the page lie. */
double *EXPORT(numbers_at)(int k) { return arms[k].numbers; }
double *EXPORT(state_at)(int k) { return arms[k].x; }
double *EXPORT(input_at)(int k) { return arms[k].u; }
double *EXPORT(parameters_at)(int k) { return arms[k].p; }
double *EXPORT(wanted_at)(void) { return wanted; }
double *EXPORT(pushed_at)(void) { return pushed; }
double *EXPORT(torque_at)(void) { return torque; }
double *EXPORT(held_point)(void) { return held_at; }
double *EXPORT(hand_at)(void) { return hand; }
double *EXPORT(force_at)(void) { return force; }
double *EXPORT(scratch_at)(void) { return scratch; }

/* What clang calls where it copies or clears structures. */
void *memcpy(void *to, const void *source, unsigned long count)
{
    char *one = to;
    const char *other = source;
    while (count--) {
        *one++ = *other++;
    }
    return to;
}

void *memset(void *to, int value, unsigned long count)
{
    char *one = to;
    while (count--) {
        *one++ = (char)value;
    }
    return to;
}
