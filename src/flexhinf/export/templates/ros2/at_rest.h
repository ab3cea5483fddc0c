/* The state of the robot @NAME@ at rest, by the model of its estimator. Made by flexhinf @VERSION@.
 * SPDX-License-Identifier: 0BSD */
#ifndef @BIG@_AT_REST_H
#define @BIG@_AT_REST_H

#include "@NAME@.h"

#ifdef __cplusplus
extern "C" {
#endif

/* At link positions q: the @BIG@_STATES numbers of the state, then the @BIG@_INPUTS of the input that holds it. */
void @NAME@_at_rest(const @NAME@_param *param, const @NAME@_real *q, @NAME@_real *rest);

#ifdef __cplusplus
}
#endif

#endif
