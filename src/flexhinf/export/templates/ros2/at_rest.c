/* The state of the robot @NAME@ at rest, by the model of its estimator. Made by flexhinf @VERSION@.
 * SPDX-License-Identifier: 0BSD */
#include "@NAME@_at_rest.h"

#include <math.h>
#include <stdbool.h>

#define FMA(a, b, c) ((a) * (b) + (c))
typedef @NAME@_real real;

@FUNCTIONS@
void @NAME@_at_rest(const @NAME@_param *param, const @NAME@_real *q, @NAME@_real *rest)
{
    @CALL@(q, param->value + @BIG@_P_PARAMETERS, rest);
}
