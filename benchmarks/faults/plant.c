#include "plant.h"

#include <math.h>
#include <string.h>

/* Outer step, s: mass matrix, weight and velocity forces are computed anew after it. At 5 rad/s the arm turns by about
 * a thousandth of a radian meanwhile. */
static const double OUTER = 2.5e-4;
/* Radians of the fastest vibration, that of a link at its end stop, that an inner step covers. */
static const double COVERED = 0.1;
/* An end stop, or a wall, is so much stiffer than the joint's spring, and damped with this ratio. */
static const double STOP = 20.0, STOP_DAMPING = 0.3;

/* A brake holds so many times the largest weight, or this share of the drive's largest torque where that is more: what
 * makers of holding brakes recommend. */
static const double BRAKES = 2.0, LEAST_BRAKE = 0.1;
/* A drive of an unknown torque holds twice the weight and turns its motor alone with this acceleration, rad/s2: as
 * `flexhinf init` estimates. */
static const double QUICK = 70.0;
/* Poses at which the weight is looked for, and a turn. */
enum { POSES = 300 };
static const double M_TURN = 6.283185307179586;

/* Vectors and rotations ------------------------------------------------------------------------------------------- */
static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static void add_cross(const double *a, const double *b, double *c)
{
    double d[3];
    cross(a, b, d);
    for (int k = 0; k < 3; ++k) { c[k] += d[k]; }
}

/* R a, and its inverse. */
static void turn(const double *R, const double *a, double *b)
{
    for (int k = 0; k < 3; ++k) { b[k] = dot(R + 3 * k, a); }
}

static void turn_back(const double *R, const double *a, double *b)
{
    for (int k = 0; k < 3; ++k) { b[k] = R[k] * a[0] + R[3 + k] * a[1] + R[6 + k] * a[2]; }
}

static void times(const double *A, const double *B, double *C)
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
        }
    }
}

/* Rodrigues: the rotation by an angle about a unit vector. */
static void rotation_about(const double *a, double angle, double *R)
{
    const double c = cos(angle), s = sin(angle), d = 1.0 - c;
    R[0] = c + a[0] * a[0] * d;
    R[1] = a[0] * a[1] * d - a[2] * s;
    R[2] = a[0] * a[2] * d + a[1] * s;
    R[3] = a[0] * a[1] * d + a[2] * s;
    R[4] = c + a[1] * a[1] * d;
    R[5] = a[1] * a[2] * d - a[0] * s;
    R[6] = a[0] * a[2] * d - a[1] * s;
    R[7] = a[1] * a[2] * d + a[0] * s;
    R[8] = c + a[2] * a[2] * d;
}

/* Symmetric matrices are xx xy xz yy yz zz. */
static void symmetric_times(const double *I, const double *a, double *b)
{
    b[0] = I[0] * a[0] + I[1] * a[1] + I[2] * a[2];
    b[1] = I[1] * a[0] + I[3] * a[1] + I[4] * a[2];
    b[2] = I[2] * a[0] + I[4] * a[1] + I[5] * a[2];
}

/* 2 (h . p) 1 - h p' - p h' + m (p . p 1 - p p'): what moments gain about an origin that is p further away. */
static void add_steiner(double m, const double *h, const double *p, double *I)
{
    const double both = 2.0 * dot(h, p) + m * dot(p, p);
    const int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
    for (int k = 0; k < 6; ++k) {
        const int i = row[k], j = column[k];
        I[k] += (i == j ? both : 0.0) - h[i] * p[j] - p[i] * h[j] - m * p[i] * p[j];
    }
}

static void turn_symmetric(const double *R, const double *I, double *J)
{
    const double full[9] = {I[0], I[1], I[2], I[1], I[3], I[4], I[2], I[4], I[5]};
    double left[9];
    times(R, full, left);
    const int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
    for (int k = 0; k < 6; ++k) { J[k] = dot(left + 3 * row[k], R + 3 * column[k]); }
}

/* Links ----------------------------------------------------------------------------------------------------------- */
typedef struct {
    double R[MOST][9], p[MOST][3]; /* of each link's frame in its parent's */
} places;

static void place_links(const plant *p, const double *q, places *at)
{
    const plant_numbers *is = &p->model.is;
    for (int i = 0; i < p->model.n; ++i) {
        memcpy(at->R[i], is->rotation[i], sizeof at->R[i]);
        memcpy(at->p[i], is->offset[i], sizeof at->p[i]);
        if (p->model.slides[i]) {
            double along[3];
            turn(is->rotation[i], is->axis[i], along);
            for (int k = 0; k < 3; ++k) { at->p[i][k] += q[i] * along[k]; }
        } else {
            double R[9];
            rotation_about(is->axis[i], q[i], R);
            times(is->rotation[i], R, at->R[i]);
        }
    }
}

/* Recursive Newton-Euler: forces that links need for accelerations a at velocities v, in a field of free fall. */
static void newton_euler(
    const plant *p, const places *at, const double *v, const double *a, const double *gravity, double *torque)
{
    const plant_model *m = &p->model;
    double spin[MOST][3], change[MOST][3], rate[MOST][3], force[MOST][3], moment[MOST][3];
    const double still[3] = {0.0, 0.0, 0.0}, lift[3] = {-gravity[0], -gravity[1], -gravity[2]};
    for (int i = 0; i < m->n; ++i) {
        const int up = m->parent[i];
        const double *axis = m->is.axis[i], *spin0 = up < 0 ? still : spin[up], *change0 = up < 0 ? still : change[up];
        double moved[3], swung[3], turned[3];
        turn_back(at->R[i], spin0, spin[i]);
        turn_back(at->R[i], change0, change[i]);
        cross(spin0, at->p[i], swung); /* acceleration of the frame's origin */
        cross(change0, at->p[i], moved);
        add_cross(spin0, swung, moved);
        for (int k = 0; k < 3; ++k) { moved[k] += up < 0 ? lift[k] : rate[up][k]; }
        turn_back(at->R[i], moved, rate[i]);
        cross(spin[i], axis, turned);
        for (int k = 0; k < 3; ++k) {
            if (m->slides[i]) {
                rate[i][k] += axis[k] * a[i] + 2.0 * turned[k] * v[i];
            } else {
                change[i][k] += axis[k] * a[i] + turned[k] * v[i];
                spin[i][k] += axis[k] * v[i];
            }
        }
        /* F = m r'' + w' x h + w x (w x h),  N = I w' + w x I w + h x r'' about the frame's origin, h = m c */
        double h[3], inner[3], own[3];
        for (int k = 0; k < 3; ++k) { h[k] = p->mass[i] * p->centre[i][k]; }
        cross(spin[i], h, inner);
        cross(change[i], h, force[i]);
        add_cross(spin[i], inner, force[i]);
        for (int k = 0; k < 3; ++k) { force[i][k] += p->mass[i] * rate[i][k]; }
        symmetric_times(p->about[i], spin[i], own);
        symmetric_times(p->about[i], change[i], moment[i]);
        add_cross(spin[i], own, moment[i]);
        add_cross(h, rate[i], moment[i]);
    }
    for (int i = m->n - 1; i >= 0; --i) {
        const int up = m->parent[i];
        torque[i] = dot(m->is.axis[i], m->slides[i] ? force[i] : moment[i]);
        if (up >= 0) {
            double F[3], N[3];
            turn(at->R[i], force[i], F);
            turn(at->R[i], moment[i], N);
            add_cross(at->p[i], F, N);
            for (int k = 0; k < 3; ++k) {
                force[up][k] += F[k];
                moment[up][k] += N[k];
            }
        }
    }
}

/* The composite-rigid-body algorithm: the mass matrix of the links. */
static void mass_matrix(const plant *p, const places *at, double M[MOST][MOST])
{
    const plant_model *m = &p->model;
    double mass[MOST], h[MOST][3], I[MOST][6];
    for (int i = 0; i < m->n; ++i) {
        mass[i] = p->mass[i];
        for (int k = 0; k < 3; ++k) { h[i][k] = p->mass[i] * p->centre[i][k]; }
        memcpy(I[i], p->about[i], sizeof I[i]);
    }
    for (int i = m->n - 1; i >= 0; --i) {
        const int up = m->parent[i];
        if (up >= 0) {
            double moved[3], turned[6];
            turn(at->R[i], h[i], moved);
            turn_symmetric(at->R[i], I[i], turned);
            add_steiner(mass[i], moved, at->p[i], turned);
            for (int k = 0; k < 6; ++k) { I[up][k] += turned[k]; }
            for (int k = 0; k < 3; ++k) { h[up][k] += moved[k] + mass[i] * at->p[i][k]; }
            mass[up] += mass[i];
        }
    }
    memset(M, 0, sizeof(double[MOST][MOST]));
    for (int i = 0; i < m->n; ++i) {
        const double *axis = m->is.axis[i];
        double F[3], N[3];
        if (m->slides[i]) {
            for (int k = 0; k < 3; ++k) { F[k] = mass[i] * axis[k]; }
            cross(h[i], axis, N);
        } else {
            cross(axis, h[i], F);
            symmetric_times(I[i], axis, N);
        }
        M[i][i] = dot(axis, m->slides[i] ? F : N);
        for (int j = i; m->parent[j] >= 0;) {
            double turned[3], moment[3];
            turn(at->R[j], F, turned);
            turn(at->R[j], N, moment);
            add_cross(at->p[j], turned, moment);
            memcpy(F, turned, sizeof F);
            memcpy(N, moment, sizeof N);
            j = m->parent[j];
            M[i][j] = M[j][i] = dot(m->is.axis[j], m->slides[j] ? F : N);
        }
    }
}

/* The inverse of a symmetric positive definite matrix, by Gauss and Jordan without pivots. */
static void inverse(int n, double A[MOST][MOST])
{
    for (int k = 0; k < n; ++k) {
        const double pivot = 1.0 / A[k][k];
        A[k][k] = 1.0;
        for (int j = 0; j < n; ++j) { A[k][j] *= pivot; }
        for (int i = 0; i < n; ++i) {
            if (i != k) {
                const double factor = A[i][k];
                A[i][k] = 0.0;
                for (int j = 0; j < n; ++j) { A[i][j] -= factor * A[k][j]; }
            }
        }
    }
}

static const double ZERO[MOST] = {0.0};

void plant_torques(const plant *p, const double *q, const double *v, const double *a, double *torque)
{
    places at;
    place_links(p, q, &at);
    newton_euler(p, &at, v, a, p->model.is.gravity, torque);
}

void plant_accelerations(const plant *p, const double *q, const double *v, const double *torque, double *a)
{
    places at;
    double M[MOST][MOST], bias[MOST];
    place_links(p, q, &at);
    newton_euler(p, &at, v, ZERO, p->model.is.gravity, bias);
    mass_matrix(p, &at, M);
    inverse(p->model.n, M);
    for (int i = 0; i < p->model.n; ++i) {
        a[i] = 0.0;
        for (int j = 0; j < p->model.n; ++j) { a[i] += M[i][j] * (torque[j] - bias[j]); }
    }
}

/* Heights are those of the centres of mass along free fall. */
static double potential(const plant *p)
{
    const plant_model *m = &p->model;
    double R[MOST][9], origin[MOST][3], energy = 0.0;
    places at;
    place_links(p, p->q, &at);
    for (int i = 0; i < m->n; ++i) {
        const int up = m->parent[i];
        double centre[3];
        if (up < 0) {
            memcpy(R[i], at.R[i], sizeof R[i]);
            memcpy(origin[i], at.p[i], sizeof origin[i]);
        } else {
            times(R[up], at.R[i], R[i]);
            turn(R[up], at.p[i], origin[i]);
            for (int k = 0; k < 3; ++k) { origin[i][k] += origin[up][k]; }
        }
        turn(R[i], p->centre[i], centre);
        for (int k = 0; k < 3; ++k) { centre[k] += origin[i][k]; }
        energy -= p->mass[i] * dot(m->is.gravity, centre);
    }
    return energy;
}

double plant_energy(const plant *p)
{
    const plant_model *m = &p->model;
    const double weightless[3] = {0.0, 0.0, 0.0};
    double momentum[MOST], energy = potential(p);
    places at;
    place_links(p, p->q, &at);
    newton_euler(p, &at, ZERO, p->v, weightless, momentum); /* M v */
    for (int i = 0; i < m->n; ++i) {
        const double twist = p->theta[i] - p->q[i], free = fmax(fabs(twist) - 0.5 * m->is.backlash[i], 0.0);
        energy += 0.5 * (p->v[i] * momentum[i] + m->is.motor_inertia[i] * p->w[i] * p->w[i]);
        energy += 0.5 * m->is.stiffness[i] * free * free + 0.25 * m->is.hardening[i] * pow(free, 4.0);
    }
    return energy;
}

/* Drives and springs ---------------------------------------------------------------------------------------------- */
static double clipped(double x, double limit) { return fmin(fmax(x, -limit), limit); }

static double spring(const plant *p, int i)
{
    const plant_numbers *is = &p->model.is;
    double twist = p->theta[i] - p->q[i];
    twist -= clipped(twist, 0.5 * is->backlash[i]);
    return is->stiffness[i] * twist + is->hardening[i] * twist * twist * twist + is->damping[i] * (p->w[i] - p->v[i]);
}

void plant_springs(const plant *p, double *torque)
{
    for (int i = 0; i < p->model.n; ++i) { torque[i] = spring(p, i); }
}

double plant_command(const plant_model *model, int joint, double torque, double theta, double w)
{
    const plant_numbers *is = &model->is;
    switch (model->drive) {
    case VOLTAGE: return is->resistance[joint] / is->torque_constant[joint] * torque + is->back_emf[joint] * w;
    case VELOCITY: return w + torque / is->drive_damping[joint];
    case POSITION: return theta + (torque + is->drive_damping[joint] * w) / is->drive_stiffness[joint];
    default: return torque / is->torque_constant[joint];
    }
}

/* Torque of a motor with a loop of its own, under a load of which it lets `load_share` act. */
static double loop_torque(const plant *p, int i, double command, double load)
{
    const plant_numbers *is = &p->model.is;
    double torque = -is->drive_damping[i] * p->w[i];
    if (p->model.drive == VELOCITY) { torque += is->drive_damping[i] * command; }
    if (p->model.drive == POSITION) { torque += is->drive_stiffness[i] * (command - p->theta[i]); }
    torque = p->gain[i] * torque + (1.0 - is->load_share[i]) * load;
    return clipped(torque, p->weakened[i] * is->largest[i]);
}

/* Torque of a motor; `keeps` is what a coil keeps of its current in the step. */
static double drive_torque(plant *p, int i, double command, double load, double keeps)
{
    const plant_numbers *is = &p->model.is;
    if (!p->powered[i]) {
        p->current[i] = 0.0;
        return 0.0;
    }
    if (p->model.drive == VELOCITY || p->model.drive == POSITION) {
        return p->forced[i] ? p->forced[i] * is->largest[i] : loop_torque(p, i, command, load);
    }
    double u = p->forced[i] ? p->forced[i] * is->effort_limit[i] : p->gain[i] * command;
    u = p->shorted[i] ? 0.0 : clipped(u, p->weakened[i] * is->effort_limit[i]);
    if (p->model.drive != VOLTAGE) { return is->torque_constant[i] * u; }
    const double steady = (u - is->back_emf[i] * p->w[i]) / is->resistance[i];
    p->current[i] = steady + keeps * (p->current[i] - steady);
    return is->torque_constant[i] * p->current[i];
}

/* Force on a link of what it touches: damped springs that only push. */
static double touched(plant *p, int i)
{
    const plant_numbers *is = &p->model.is;
    const double k = p->contact_stiffness[i], d = p->contact_damping[i];
    double force = 0.0;
    if (p->q[i] > is->upper[i]) { force -= fmax(k * (p->q[i] - is->upper[i]) + d * p->v[i], 0.0); }
    if (p->q[i] < is->lower[i]) { force -= fmin(k * (p->q[i] - is->lower[i]) + d * p->v[i], 0.0); }
    if (p->walled[i] != 0) {
        const double push = k * (p->q[i] - p->wall[i]) + d * p->v[i];
        if (p->walled[i] == 2) { force -= push; }
        if (p->walled[i] == 1 && p->q[i] > p->wall[i]) { force -= fmax(push, 0.0); }
        if (p->walled[i] == -1 && p->q[i] < p->wall[i]) { force -= fmin(push, 0.0); }
    }
    p->contact = fmax(p->contact, fabs(force));
    return force;
}

/* What dry friction and a closed brake take of a motor at most. */
static double dry(const plant *p, int i, double load)
{
    const plant_numbers *is = &p->model.is;
    double level = is->coulomb[i] + is->load_friction[i] * fabs(load);
    if (is->stiction[i] > is->coulomb[i]) {
        const double ratio = p->w[i] / is->stribeck[i];
        level += (is->stiction[i] - is->coulomb[i]) * exp(-ratio * ratio);
    }
    return level + (p->braked[i] ? fmax(is->brake[i], 0.0) : 0.0);
}

/* Semi-implicit Euler: velocities first, positions with the new ones. Dry friction is Moreau's: it takes what it can of
 * the velocity that a motor would have, and never turns it round, so that a motor truly sticks. */
static void inner_step(
    plant *p, const double *command, double M[MOST][MOST], const double *bias, const double *keeps, double h)
{
    const plant_numbers *is = &p->model.is;
    const int n = p->model.n;
    double force[MOST];
    for (int i = 0; i < n; ++i) {
        const double load = spring(p, i), resisting = load + is->friction[i] * p->w[i];
        const double driven = drive_torque(p, i, command[i], resisting, keeps[i]) - resisting;
        const double wanted = p->w[i] * is->motor_inertia[i] / h + driven;
        force[i] = load - bias[i] + touched(p, i);
        p->w[i] = (wanted - clipped(wanted, dry(p, i, load))) * h / is->motor_inertia[i];
    }
    for (int i = 0; i < n; ++i) {
        double a = 0.0;
        for (int j = 0; j < n; ++j) { a += M[i][j] * force[j]; }
        p->v[i] += h * a;
    }
    for (int i = 0; i < n; ++i) {
        p->q[i] += h * p->v[i];
        p->theta[i] += h * p->w[i];
    }
}

void plant_run(plant *p, const double *command, double period, int refined)
{
    const plant_numbers *is = &p->model.is;
    const int n = p->model.n, outer = (int)ceil(period / OUTER * refined - 1e-9);
    const double step = period / outer, h = step / p->steps;
    double keeps[MOST];
    for (int i = 0; i < n; ++i) {
        keeps[i] = is->inductance[i] > 0.0 ? exp(-h * is->resistance[i] / is->inductance[i]) : 0.0;
    }
    for (int k = 0; k < outer; ++k) {
        places at;
        double M[MOST][MOST], bias[MOST], middle[MOST];
        for (int i = 0; i < n; ++i) { middle[i] = p->q[i] + 0.5 * step * p->v[i]; }
        place_links(p, middle, &at);
        newton_euler(p, &at, p->v, ZERO, is->gravity, bias);
        mass_matrix(p, &at, M);
        inverse(n, M);
        for (int s = 0; s < p->steps; ++s) { inner_step(p, command, M, bias, keeps, h); }
    }
}

/* Beginning ------------------------------------------------------------------------------------------------------- */
void plant_draw(plant_model *drawn, const plant_model *low, const plant_model *high, double (*uniform)(void))
{
    *drawn = *low;
    double *is = (double *)&drawn->is;
    const double *least = (const double *)&low->is, *most = (const double *)&high->is;
    for (unsigned k = 0; k < sizeof drawn->is / sizeof *is; ++k) {
        if (most[k] > least[k] && most[k] < HUGE_VAL) { is[k] = least[k] + uniform() * (most[k] - least[k]); }
    }
    for (int i = 0; i < drawn->n; ++i) { /* both gains of a drive are those of one bandwidth */
        const double soft = low->is.drive_stiffness[i], stiff = high->is.drive_stiffness[i];
        const double slow = low->is.drive_damping[i], fast = high->is.drive_damping[i];
        if (stiff > soft && fast > slow) {
            drawn->is.drive_damping[i] = slow + (drawn->is.drive_stiffness[i] - soft) / (stiff - soft) * (fast - slow);
        }
    }
}

void plant_carry(plant *p, double payload)
{
    const plant_numbers *is = &p->model.is;
    for (int i = 0; i < p->model.n; ++i) {
        double h[3], mass = is->mass[i];
        for (int k = 0; k < 3; ++k) { h[k] = mass * is->centre[i][k]; }
        for (int k = 0; k < 6; ++k) { p->about[i][k] = is->inertia_scale[i] * is->inertia[i][k]; }
        add_steiner(mass, ZERO, is->centre[i], p->about[i]);
        if (i == p->model.loaded) {
            mass += payload;
            for (int k = 0; k < 3; ++k) { h[k] += payload * is->payload_centre[k]; }
            for (int k = 0; k < 6; ++k) { p->about[i][k] += payload * is->payload_inertia[k]; }
            add_steiner(payload, ZERO, is->payload_centre, p->about[i]);
        }
        p->mass[i] = mass;
        for (int k = 0; k < 3; ++k) { p->centre[i][k] = mass > 0.0 ? h[k] / mass : 0.0; }
    }
}

/* Weight that each joint holds at most, of a grid of poses that a golden-ratio sequence makes. */
static void heaviest(const plant_model *model, double *weight)
{
    const double golden[MOST] = {0.8956, 0.8020, 0.7183, 0.6433, 0.5761, 0.5159, 0.4620}; /* powers: Roberts, d = 7 */
    plant p;
    memset(&p, 0, sizeof p);
    p.model = *model;
    plant_carry(&p, model->is.payload);
    memset(weight, 0, sizeof(double) * MOST);
    for (int k = 1; k <= POSES; ++k) {
        double q[MOST], held[MOST];
        for (int i = 0; i < model->n; ++i) {
            const double low = fmax(model->is.lower[i], -M_TURN / 2.0), high = fmin(model->is.upper[i], M_TURN / 2.0);
            q[i] = low + fmod(k * golden[i], 1.0) * (high - low);
        }
        plant_torques(&p, q, ZERO, ZERO, held);
        for (int i = 0; i < model->n; ++i) { weight[i] = fmax(weight[i], fabs(held[i])); }
    }
}

void plant_complete(plant_model *model)
{
    plant_numbers *is = &model->is;
    double weight[MOST];
    heaviest(model, weight);
    for (int i = 0; i < model->n; ++i) {
        is->largest[i] = is->torque_constant[i] * is->effort_limit[i];
        if (model->drive == VOLTAGE) { is->largest[i] /= is->resistance[i]; }
        if (model->drive == VELOCITY || model->drive == POSITION) {
            const int stated = is->drive_limit[i] < HUGE_VAL;
            is->largest[i] = stated ? is->drive_limit[i] : 2.0 * weight[i] + QUICK * is->motor_inertia[i];
        }
        if (is->brake[i] >= 0.0) { is->brake[i] = BRAKES * fmax(weight[i], LEAST_BRAKE * is->largest[i]); }
    }
}

/* Twist of a spring at rest under a torque, by Newton where it hardens. */
static double twist_of(const plant_numbers *is, int i, double torque)
{
    double twist = torque / is->stiffness[i];
    for (int k = 0; k < 20 && is->hardening[i] > 0.0; ++k) {
        const double left = is->stiffness[i] * twist + is->hardening[i] * twist * twist * twist - torque;
        twist -= left / (is->stiffness[i] + 3.0 * is->hardening[i] * twist * twist);
    }
    return twist + copysign(0.5 * is->backlash[i], torque);
}

/* Stops are damped by what a joint alone moves, where the arm begins; inner steps resolve the fastest vibration. */
static void prepare(plant *p)
{
    const plant_numbers *is = &p->model.is;
    double M[MOST][MOST], fastest = 1.0;
    places at;
    place_links(p, p->q, &at);
    mass_matrix(p, &at, M);
    inverse(p->model.n, M);
    for (int i = 0; i < p->model.n; ++i) {
        p->contact_stiffness[i] = STOP * is->stiffness[i];
        p->contact_damping[i] = 2.0 * STOP_DAMPING * sqrt(p->contact_stiffness[i] / M[i][i]);
        fastest = fmax(fastest, sqrt((p->contact_stiffness[i] + is->stiffness[i]) * M[i][i]));
        fastest = fmax(fastest, sqrt((is->stiffness[i] + is->drive_stiffness[i]) / is->motor_inertia[i]));
    }
    p->steps = (int)ceil(fastest * OUTER / COVERED);
}

void plant_begin(plant *p, const plant_model *model, const double *q)
{
    double hold[MOST];
    memset(p, 0, sizeof *p);
    p->model = *model;
    plant_carry(p, model->is.payload);
    memcpy(p->q, q, sizeof(double) * (unsigned)model->n);
    plant_torques(p, q, ZERO, ZERO, hold);
    for (int i = 0; i < model->n; ++i) {
        p->theta[i] = q[i] + twist_of(&model->is, i, hold[i]);
        p->current[i] = hold[i] / model->is.torque_constant[i];
        p->powered[i] = 1;
        p->gain[i] = p->weakened[i] = 1.0;
    }
    prepare(p);
}
