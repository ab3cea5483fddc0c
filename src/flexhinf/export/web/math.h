/* What the exported C needs of <math.h>, where there is no C library: clang's own functions, and those that the page
 * imports from JavaScript's Math. */
#ifndef FLEXHINF_MATH_H
#define FLEXHINF_MATH_H

#define HUGE_VAL __builtin_huge_val()
#define NAN __builtin_nanf("")
#define INFINITY __builtin_inff()
#define isfinite(x) __builtin_isfinite(x)
#define isnan(x) __builtin_isnan(x)

static inline double fabs(double x) { return __builtin_fabs(x); }
static inline double sqrt(double x) { return __builtin_sqrt(x); }
static inline double floor(double x) { return __builtin_floor(x); }
static inline double ceil(double x) { return __builtin_ceil(x); }
static inline double copysign(double x, double y) { return __builtin_copysign(x, y); }

#define IMPORTED(name) double name
IMPORTED(sin)(double);
IMPORTED(cos)(double);
IMPORTED(tan)(double);
IMPORTED(asin)(double);
IMPORTED(acos)(double);
IMPORTED(atan)(double);
IMPORTED(atan2)(double, double);
IMPORTED(sinh)(double);
IMPORTED(cosh)(double);
IMPORTED(tanh)(double);
IMPORTED(asinh)(double);
IMPORTED(acosh)(double);
IMPORTED(atanh)(double);
IMPORTED(exp)(double);
IMPORTED(expm1)(double);
IMPORTED(log)(double);
IMPORTED(log1p)(double);
IMPORTED(pow)(double, double);
IMPORTED(hypot)(double, double);
IMPORTED(fmod)(double, double);
IMPORTED(remainder)(double, double);

#endif
