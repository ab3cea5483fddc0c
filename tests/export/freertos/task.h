/* A stub: functions of FreeRTOS that a task uses. */
#ifndef TASK_H
#define TASK_H

typedef void *TaskHandle_t;
typedef void (*TaskFunction_t)(void *);

TaskHandle_t xTaskCreateStatic(TaskFunction_t code, const char *const name, const uint32_t depth, void *const parameters,
                               UBaseType_t priority, StackType_t *const stack, StaticTask_t *const task);
TickType_t xTaskGetTickCount(void);
BaseType_t xTaskDelayUntil(TickType_t *const previous, const TickType_t increment);
void vTaskDelete(TaskHandle_t task);
void vTaskStartScheduler(void);

#endif
