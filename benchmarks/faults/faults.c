#include "bench.h"

#include <math.h>
#include <string.h>

/* The kinds; `benchmarks.faults.kinds` says what each means, its unit and its range. */
enum {
    NONE,
    /* sensors */
    JUMP, MIRRORED, BACKWARD, SWAPPED, STUCK, ZERO, SCALED, SLIPS, DRIFT, WRAPPED, LATE, SILENT, DROPOUTS, NOISE,
    GLITCHES, COARSE,
    /* frames */
    FROZEN, REPEATS, UNMEASURED,
    /* drives */
    DEAD, FULL, INVERTED, EXCHANGED, WEAK, LIMITED, HELD, DELAYED, BIASED, SHORTED,
    /* mechanics */
    SPRING, WALL, BLOCKED, BRAKED, DRAGGED, ESTOP, UNPOWERED, PAYLOAD,
    /* the start */
    OFFSET, ELSEWHERE, HOMED, MOVING, COMMANDED,
    /* the clock */
    JITTER, PERIOD, OVERRUN, HICCUP,
    KINDS
};
static const char *const NAMES[KINDS] = {
    "none", "jump", "mirrored", "backward", "swapped", "stuck", "zero", "scaled", "slips", "drift", "wrapped", "late",
    "silent", "dropouts", "noise", "glitches", "coarse", "frozen", "repeats", "unmeasured", "dead", "full", "inverted",
    "exchanged", "weak", "limited", "held", "delayed", "biased", "shorted", "spring", "wall", "blocked", "braked",
    "dragged", "estop", "unpowered", "payload", "offset", "elsewhere", "homed", "moving", "commanded", "jitter", "period",
    "overrun", "hiccup"
};

/* Share of samples with a glitch; samples from one burst of repeated frames, or one overrun, to the next. */
static const double GLITCHING = 0.02;
enum { EVERY = 100 };

int fault_named(const char *name)
{
    for (int k = 0; k < KINDS; ++k) {
        if (strcmp(NAMES[k], name) == 0) { return k; }
    }
    return -1;
}

static int is_meant(const bench *b, int joint) { return b->asked.joint < 0 || b->asked.joint == joint; }

/* Whether a sensor is one of the side and the joint of the fault, or of the joint that it is swapped with. */
static int senses(const bench *b, int i)
{
    const int kind = SENSORS[i].kind, of_motor = kind == MOTOR_POSITION || kind == MOTOR_VELOCITY;
    const int swapped = b->asked.kind == SWAPPED && SENSORS[i].joint == b->asked.other;
    return (is_meant(b, SENSORS[i].joint) || swapped) && (of_motor ? b->asked.motors : b->asked.links);
}

/* The start ------------------------------------------------------------------------------------------------------- */
void fault_starts(bench *b, double *q)
{
    for (int i = 0; i < NOMINAL.n; ++i) {
        const int away = b->asked.kind == ELSEWHERE || b->asked.kind == HOMED;
        if (away && is_meant(b, i)) { q[i] += b->asked.magnitude; }
    }
}

void fault_moving(bench *b)
{
    for (int i = 0; i < NOMINAL.n && b->asked.kind == MOVING; ++i) {
        if (is_meant(b, i)) { b->arm.v[i] = b->arm.w[i] = b->asked.magnitude; }
    }
}

/* The arm --------------------------------------------------------------------------------------------------------- */
static void break_joint(bench *b, int i, int first, int over)
{
    plant *arm = &b->arm;
    const double m = b->asked.magnitude;
    switch (b->asked.kind) {
    case DEAD: arm->powered[i] = 0; break;
    case FULL: arm->forced[i] = m < 0.0 ? -1 : 1; break;
    case INVERTED: arm->gain[i] = -1.0; break;
    case WEAK: arm->gain[i] = m; break;
    case LIMITED: arm->weakened[i] = m; break;
    case SHORTED: arm->shorted[i] = 1; break;
    case SPRING:
        if (first) {
            arm->model.is.stiffness[i] *= m;
            arm->model.is.damping[i] *= m;
            arm->model.is.hardening[i] *= m;
        }
        break;
    case WALL:
    case BLOCKED:
        if (first) { arm->wall[i] = arm->q[i] + (b->asked.kind == WALL ? m : 0.0); }
        arm->walled[i] = b->asked.kind == WALL ? (m < 0.0 ? -1 : 1) : over ? 0 : 2;
        break;
    case BRAKED:
    case ESTOP: arm->powered[i] = over; arm->braked[i] = !over; break;
    case UNPOWERED: arm->powered[i] = over; break;
    case DRAGGED: arm->braked[i] = !over; break;
    default: break;
    }
}

void fault_arm(bench *b)
{
    const int first = b->on && !b->begun;
    const int over = b->t - b->asked.at >= b->asked.magnitude - 1e-9; /* of those that last for the magnitude, s */
    for (int i = 0; i < NOMINAL.n && b->on; ++i) {
        if (is_meant(b, i)) { break_joint(b, i, first, over); }
    }
    if (first && b->asked.kind == PAYLOAD) { plant_carry(&b->arm, b->asked.magnitude); }
}

/* Sensors --------------------------------------------------------------------------------------------------------- */
static const double *frame(const bench *b, int late) { return b->y[(b->k - late + HISTORY) % HISTORY]; }

/* The value of the same sensor of the other joint. */
static double of_other(const bench *b, int i)
{
    const int own = SENSORS[i].joint, other = own == b->asked.joint ? b->asked.other : b->asked.joint;
    for (int j = 0; j < ARM_MEASUREMENTS; ++j) {
        if (SENSORS[j].kind == SENSORS[i].kind && SENSORS[j].joint == other) { return frame(b, 0)[j]; }
    }
    return frame(b, 0)[i];
}

static double sensed(bench *b, int i)
{
    const double y = frame(b, 0)[i], m = b->asked.magnitude, s = b->t - b->asked.at;
    const int late = (int)fmin(fmin(m + 0.5, HISTORY - 1.0), b->k);
    switch (b->asked.kind) {
    case OFFSET:
    case JUMP: return y + m;
    case HOMED: return y - m; /* the encoders were set to home where the arm is not */
    case MIRRORED: return -y;
    case BACKWARD: return 2.0 * b->kept[i] - y;
    case SWAPPED: return of_other(b, i);
    case STUCK: return b->kept[i];
    case ZERO: return 0.0;
    case SCALED: return m * y;
    case SLIPS: return b->kept[i] + m * (y - b->kept[i]);
    case DRIFT: return y + m * s;
    case WRAPPED: return y + m * SENSORS[i].turn;
    case LATE: return frame(b, late)[i];
    case SILENT: return NAN;
    case DROPOUTS: return uniform(b, OF_FAULT) < m ? NAN : y;
    case NOISE: return y + m * normal(b, OF_FAULT);
    case GLITCHES: return uniform(b, OF_FAULT) < GLITCHING ? y + m : y;
    case COARSE: return m * floor(y / m + 0.5);
    default: return y;
    }
}

/* Samples since the frame that is repeated; 0: this one is new. */
static int repeats(const bench *b)
{
    const int since = (int)floor((b->t - b->asked.at) / ARM_PERIOD + 0.5), many = (int)(b->asked.magnitude / ARM_PERIOD + 0.5);
    if (!b->on) { return 0; }
    if (b->asked.kind == FROZEN) { return since < many ? since + 1 : 0; }
    if (b->asked.kind == REPEATS) { return since % EVERY < many ? since % EVERY + 1 : 0; }
    return 0;
}

void fault_sensors(bench *b)
{
    const int first = b->on && !b->begun, old = repeats(b);
    if (first) { memcpy(b->kept, frame(b, 0), sizeof b->kept); }
    if (old == 1) { memcpy(b->kept, b->k > 0 ? frame(b, 1) : frame(b, 0), sizeof b->kept); }
    b->input.measured = 1;
    for (int i = 0; i < ARM_MEASUREMENTS; ++i) {
        double y = frame(b, 0)[i];
        if (b->on && senses(b, i)) { y = sensed(b, i); }
        if (old > 0) { y = b->kept[i]; }
        b->repeated[i] = old > 0 || (b->on && senses(b, i) && b->asked.kind == STUCK);
        b->given[i] = y;
        b->input.y[i] = (arm_real)y;
    }
    if (b->on && b->asked.kind == UNMEASURED && b->t - b->asked.at < b->asked.magnitude) { b->input.measured = 0; }
}

/* Inputs ---------------------------------------------------------------------------------------------------------- */
void fault_inputs(bench *b, double *u)
{
    const int j = b->asked.joint, other = b->asked.other;
    memcpy(b->u[b->k % HISTORY], u, sizeof b->u[0]);
    if (!b->on) { return; }
    if (!b->begun) { memcpy(b->before, u, sizeof b->before); }
    for (int i = 0; i < NOMINAL.n; ++i) {
        const double was = u[i];
        if (!is_meant(b, i)) { continue; }
        if (b->asked.kind == HELD) { u[i] = b->before[i]; }
        if (b->asked.kind == BIASED) { u[i] = was + b->asked.magnitude * NOMINAL.is.effort_limit[i]; }
        if (b->asked.kind == DELAYED) {
            const int late = (int)fmin(b->asked.magnitude + 0.5, b->k < HISTORY ? b->k : HISTORY - 1);
            u[i] = b->u[(b->k - late) % HISTORY][i];
        }
    }
    if (b->asked.kind == EXCHANGED && j >= 0) {
        const double was = u[j];
        u[j] = u[other];
        u[other] = was;
    }
}

/* The clock ------------------------------------------------------------------------------------------------------- */
double fault_period(bench *b)
{
    const double T = ARM_PERIOD, m = b->asked.magnitude;
    if (!b->on) { return T; }
    switch (b->asked.kind) {
    case JITTER: return T * (1.0 + m * (2.0 * uniform(b, OF_FAULT) - 1.0));
    case PERIOD: return T * m;
    case OVERRUN: return b->k % EVERY == 0 ? m : T;
    case HICCUP: return b->begun ? T : m;
    default: return T;
    }
}
