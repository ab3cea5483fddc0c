/* A stub: types and configuration of FreeRTOS that a task uses. */
#ifndef FREERTOS_H
#define FREERTOS_H

#include <stddef.h>
#include <stdint.h>

#ifndef configTICK_RATE_HZ
#define configTICK_RATE_HZ ((TickType_t)1000)
#endif
#define configMAX_PRIORITIES (5)

typedef uint32_t TickType_t, StackType_t;
typedef long BaseType_t;
typedef unsigned long UBaseType_t;
typedef struct {
    void *top;
} StaticTask_t;

#define pdFALSE ((BaseType_t)0)
#define pdTRUE ((BaseType_t)1)

#endif
