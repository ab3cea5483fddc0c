/* A robot arm with elastic joints, from the textbook: it shares no code with flexhinf.
 *
 * Rigid links in a tree [Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6], a spring with damping
 * behind each, a rotor behind each spring, drives, dry friction that sticks, end stops, obstacles, brakes and a payload.
 * Quantities of motors are those at the joint, behind the gear. SI units; a joint that slides has m where others have
 * rad. */
#ifndef FAULTS_PLANT_H
#define FAULTS_PLANT_H

enum { MOST = 7 }; /* joints */

/* What a drive takes. */
enum { TORQUE, CURRENT, VOLTAGE, VELOCITY, POSITION };

/* Numbers of a robot; nothing but doubles, so that each can be drawn between its lowest and its highest. */
typedef struct {
    double gravity[3];                                          /* of free fall, m/s2, in the frame of the base */
    double rotation[MOST][9], offset[MOST][3];                  /* of a link's frame in its parent's at position 0 */
    double axis[MOST][3];                                       /* in the link's frame */
    double mass[MOST], centre[MOST][3], inertia[MOST][6];       /* xx xy xz yy yz zz about the centre of mass */
    double inertia_scale[MOST];                                 /* a tolerance of all six */
    double payload, payload_centre[3], payload_inertia[6];      /* kg; m; m2: about its centre of mass, per kg */
    double stiffness[MOST], damping[MOST], hardening[MOST];     /* of springs: K d + D d' + H d^3 */
    double backlash[MOST];                                      /* the whole gap, rad */
    double motor_inertia[MOST], friction[MOST];                 /* friction: viscous */
    double coulomb[MOST], stiction[MOST], stribeck[MOST];       /* F(w) = Fc + (Fs - Fc) exp(-(w / ws)^2) */
    double load_friction[MOST];                                 /* more of it, per torque of the spring */
    double resistance[MOST], inductance[MOST];                  /* of a motor that a voltage drives */
    double torque_constant[MOST], back_emf[MOST];               /* N m / A, V s / rad; 1 and 0 of a torque drive */
    double drive_stiffness[MOST], drive_damping[MOST];          /* of a drive with a loop of its own */
    double load_share[MOST];                                    /* of friction and spring that such a drive feels */
    double drive_limit[MOST];                                   /* largest torque of such a drive; HUGE_VAL: none */
    double lower[MOST], upper[MOST];                            /* end stops */
    double speed_limit[MOST], effort_limit[MOST];               /* of a joint; of the command */
    double largest[MOST];                                       /* torque of a drive at rest */
    double brake[MOST];                                         /* what a closed brake holds */
} plant_numbers;

typedef struct {
    int n, drive, loaded; /* joints; what the drives take; the link with the payload */
    int parent[MOST];     /* -1: the base */
    int slides[MOST];
    plant_numbers is;
} plant_model;

/* An arm in motion, with what is wrong with it. */
typedef struct {
    plant_model model;
    double q[MOST], v[MOST];     /* links */
    double theta[MOST], w[MOST]; /* motors */
    double current[MOST];        /* of a motor that a voltage drives */
    int powered[MOST];           /* 0: the drive gives no torque, and its coil carries no current */
    int braked[MOST];
    double gain[MOST];           /* of what a drive does: 1; -1 is one with reversed phases */
    double weakened[MOST];       /* largest share of its torque that a drive gives: 1 */
    int shorted[MOST];           /* the windings of a voltage drive are short-circuited */
    int forced[MOST];            /* 1 or -1: the drive gives its largest torque, whatever the command */
    int walled[MOST];            /* 1: a wall in the way up; -1: in the way down; 2: held from both sides */
    double wall[MOST];
    double contact;              /* largest force of walls and end stops so far */
    double contact_stiffness[MOST], contact_damping[MOST];
    int steps;                   /* inner ones of an outer step */
    double mass[MOST], centre[MOST][3], about[MOST][6]; /* links with payload; moments about their frames' origins */
} plant;

/* Numbers between low and high, each with uniform probability, by `uniform` of the caller. */
void plant_draw(plant_model *drawn, const plant_model *low, const plant_model *high, double (*uniform)(void));

/* What no file states: the largest torque of a drive with a loop of its own and without a limit, and what brakes hold;
 * a joint whose brake is below 0 has none. */
void plant_complete(plant_model *model);

/* At rest with the links at q, drives on, brakes open, nothing wrong. */
void plant_begin(plant *p, const plant_model *model, const double *q);

/* The payload becomes another one, kg. */
void plant_carry(plant *p, double payload);

/* One period with a command of the drives. `refined` divides both steps: 1, or more in a test of convergence. */
void plant_run(plant *p, const double *command, double period, int refined);

/* Torques that springs need to hold or move the links: M(q) a + C(q, v) v + g(q). */
void plant_torques(const plant *p, const double *q, const double *v, const double *a, double *torque);

/* Accelerations of the links under torques of the springs, without stops and walls. */
void plant_accelerations(const plant *p, const double *q, const double *v, const double *torque, double *a);

/* Kinetic and potential energy of links, rotors and springs, J. */
double plant_energy(const plant *p);

/* Torque of the springs on the links. */
void plant_springs(const plant *p, double *torque);

/* The command with which the drives give a torque to motors that move at w, and are at theta. */
double plant_command(const plant_model *model, int joint, double torque, double theta, double w);

#endif
