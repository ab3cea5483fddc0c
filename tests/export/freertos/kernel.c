/* A stand-in for the kernel: one task, on the stack of the processor's start, woken by SysTick. */
#include "FreeRTOS.h"
#include "task.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

void arm_task(void);
void tick(void);

static volatile TickType_t ticks;
static TaskFunction_t entry;

void tick(void) { ticks += 1; }

TaskHandle_t xTaskCreateStatic(TaskFunction_t code, const char *const name, const uint32_t depth, void *const parameters,
                               UBaseType_t priority, StackType_t *const stack, StaticTask_t *const task)
{
    (void)name;
    (void)depth;
    (void)stack;
    (void)parameters;
    (void)priority;
    entry = code;
    return task;
}

TickType_t xTaskGetTickCount(void) { return ticks; }

BaseType_t xTaskDelayUntil(TickType_t *const previous, const TickType_t increment)
{
    const TickType_t due = *previous + increment;
    const BaseType_t waits = (int32_t)(due - ticks) > 0 ? pdTRUE : pdFALSE;
    while ((int32_t)(due - ticks) > 0) {
        __asm volatile("wfi");
    }
    *previous = due;
    return waits;
}

void vTaskDelete(TaskHandle_t task)
{
    (void)task;
    for (;;) {
    }
}

void vTaskStartScheduler(void)
{
    REGISTER(0xe000e014u) = 25000000u / (uint32_t)configTICK_RATE_HZ - 1u;
    REGISTER(0xe000e018u) = 0;
    REGISTER(0xe000e010u) = 7;
    entry(NULL);
}

int main(void)
{
    arm_task();
    vTaskStartScheduler();
    return 1;
}
