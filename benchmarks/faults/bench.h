/* One run: the arm, the exported controller that drives it, what is wrong, and what is measured of it. */
#ifndef FAULTS_BENCH_H
#define FAULTS_BENCH_H

#include "arm.h"
#include "arm_follow.h"
#include "plant.h"

/* What is measured, in the order of `benchmarks.faults.arms.SENSORS`. */
enum { LINK_POSITION, MOTOR_POSITION, JOINT_TORQUE, DEFLECTION, LINK_VELOCITY, MOTOR_VELOCITY };

/* A measurement: of which joint, its noise (standard deviation), the step of its values, 0: none, and a turn of its
 * encoder, seen at the joint. */
typedef struct {
    int kind, joint;
    double noise, step, turn;
} sensor;

/* Made of the robot file and of the export: robot.h. */
extern plant_model NOMINAL, LOWEST, HIGHEST;
extern const double HOME[];
extern const sensor SENSORS[];

enum { HISTORY = 512, STREAMS = 4 };
enum { OF_ROBOT, OF_MOVES, OF_NOISE, OF_FAULT }; /* random numbers of these do not change one another */

/* What is asked of a run. */
typedef struct {
    int kind;             /* of the fault, see faults.c */
    int links, motors;    /* whether sensors of the links, of the motors, are meant */
    int joint, other;     /* -1: every joint */
    double magnitude, at; /* in the unit of the kind; s */
    double lasts;         /* s that the run goes on behind the fault where nobody stops it */
    double speed;         /* of the moves, as a fraction of the speed limits */
    int moves;            /* where above 0, so many, and the run ends with the last */
    int never;            /* 1: nothing stops the arm */
    int refined;          /* the integrator's steps are divided by this */
    unsigned long long seed;
} request;

/* What the rule decides of a sample. */
typedef struct {
    int power;         /* whether drives may have power */
    unsigned int stop; /* latched reasons; 0: none */
    int category;      /* of IEC 60204-1: 0, 1 or 2; -1: none */
} decision;

typedef struct {
    double q[MOST], command[MOST];
} moment;

/* When something was first so, s behind the fault; below 0: never. */
enum { FIRST_CODE = 0, FIRST_REJECTED = 1, FIRST_UNSEEN = 2, FIRST_PATH = 3, FIRST_STATUS = 4, FIRSTS = 20 };

typedef struct {
    moment fault, notice;
    int noticed, early, code, status, category;
    unsigned int stop;
    double last[MOST], going[MOST]; /* of wrong motion: where links were, and how far they went away */
    double when;                    /* of the notice, s behind the fault */
    double wrong;                   /* from the fault to the notice: wrong motion, see verdict.py */
    double wrong_at_notice, hundred; /* hundred: s until it was 0.1 rad; below 0: never */
    double furthest, ideal, step;   /* behind the notice; of the ideal stop; what joints move in a sample then */
    double held;                    /* of an ideal stop in which drives brake where no brake does */
    double beyond, speed;           /* largest distance from the command; speed over the limit */
    double fell;                    /* behind the notice and without power, where no brake holds the arm */
    double end, moving;             /* at the end: distance from the command, largest speed lately */
    double off[MOST];               /* where links were when power went */
    double first[FIRSTS];
    double rested;                  /* s behind the fault: the last sample in which something moved */
    int first_code, rest;           /* rest: samples, one after the other, in which nothing moved */
    int falls;                      /* 1: power went; 2: where no brake holds an arm that rested */
    int lost;                       /* 1: the arm went so far that nothing more was computed */
    int moves;
} record;

typedef struct {
    request asked;
    plant arm;
    arm_state controller;
    arm_follow_state follow;
    arm_follow_point point;
    arm_input input;
    arm_output output;
    arm_follow_output row;
    decision said;
    record found;
    double t, elapsed; /* elapsed: since the sample before, by the clock of the arm */
    int k, on, acts, active;
    double rests_until;              /* s: then the next move begins */
    double queue[16][MOST];          /* inputs on their way, by the latency of the design */
    double y[HISTORY][ARM_MEASUREMENTS]; /* as the sensors gave them, before the fault */
    double u[HISTORY][MOST];         /* as the controller gave them */
    double given[ARM_MEASUREMENTS];  /* what the controller got */
    double applied[MOST];
    int repeated[ARM_MEASUREMENTS];  /* whether a sensor gave an old value: what a caller with stamps would know */
    double kept[ARM_MEASUREMENTS];   /* by the fault: where a sensor stuck */
    double before[MOST];             /* by the fault: the payload, springs and damping before; an input that stuck */
    int begun;                       /* whether the fault has begun */
    int refused;                     /* why the start was refused; 0: it was not */
    unsigned long long random[STREAMS];
} bench;

/* A number of at least 0 and below 1; one of the normal distribution. */
double uniform(bench *b, int stream);
double normal(bench *b, int stream);

/* faults.c: a kind by its name, -1: none is called so; what it does to the arm, to sensors, to inputs and to the time
 * until the next sample. `fault_starts` is asked once, before the controller starts. */
int fault_named(const char *name);
void fault_starts(bench *b, double *q);
void fault_moving(bench *b);
void fault_arm(bench *b);
void fault_sensors(bench *b);
void fault_inputs(bench *b, double *u);
double fault_period(bench *b);

/* moves.c: from goal to goal, as the caller of an exported controller makes commands. */
void moves_begin(bench *b, const double *q);
void moves_step(bench *b);

/* record.c */
void record_begin(bench *b);
void record_sample(bench *b, int code);
void record_print(const bench *b);
void trace_open(const char *path);
void trace_sample(const bench *b, int code);
void trace_close(void);

#endif
