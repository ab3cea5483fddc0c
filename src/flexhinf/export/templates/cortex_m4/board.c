/* The test vector of @{name} on a Cortex-M4F that QEMU emulates (machine mps2-an386): start-up, and what a step costs.
 * Made by flexhinf @{version}; `make cortex-m4` builds and runs it. Not for a project of yours: boards have their own. */
#include "@{name}.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

/* A timer of this machine counts down at 25 MHz, and `-icount shift=10` makes every instruction last 1024 ns of it:
 * an instruction is 25.6 counts. */
#define TIMER_CONTROL REGISTER(0x40000000u)
#define TIMER_VALUE REGISTER(0x40000004u)
#define TIMER_RELOAD REGISTER(0x40000008u)

/* The floating-point unit is off after a reset. */
#define COPROCESSORS REGISTER(0xe000ed88u)

enum { PAINTED = 65536 }; /* words of stack that are watched */
static const uint32_t PAINT = 0xa5a5a5a5u;

extern uint32_t data_begin[], data_end[], data_stored[], bss_begin[], bss_end[], stack_top[];
extern void initialise_monitor_handles(void); /* of the C library: its output goes to QEMU */
extern int main(void);
extern void tick(void) __attribute__((weak)); /* the handler of SysTick, where there is one */

static uint32_t steps, most_instructions, deepest;
static uint64_t all_instructions;

/* The linker (--wrap) calls the second where the test vector calls @{name}_step, which is the first. */
int __real_@{name}_step(@{name}_state *, const @{name}_param *, const @{name}_input *, @{name}_output *);
int __wrap_@{name}_step(@{name}_state *, const @{name}_param *, const @{name}_input *, @{name}_output *);

static uint32_t instructions_since(uint32_t start)
{
    return (uint32_t)((uint64_t)(start - TIMER_VALUE) * 10u / 256u);
}

int __wrap_@{name}_step(@{name}_state *state, const @{name}_param *param, const @{name}_input *input,
                       @{name}_output *output)
{
    volatile uint32_t *here, *word;
    uint32_t start, reading, spent, used;
    int code;
    __asm volatile("mov %0, sp" : "=r"(here));
    for (word = here - PAINTED; word < here; ++word) {
        *word = PAINT;
    }
    start = TIMER_VALUE;
    reading = instructions_since(start);
    start = TIMER_VALUE;
    code = __real_@{name}_step(state, param, input, output);
    spent = instructions_since(start) - reading;
    for (word = here - PAINTED; word < here && *word == PAINT; ++word) {
    }
    used = (uint32_t)(here - word) * (uint32_t)sizeof *word;
    deepest = used > deepest ? used : deepest;
    most_instructions = spent > most_instructions ? spent : most_instructions;
    all_instructions += spent;
    steps += 1;
    return code;
}

static void reset(void)
{
    const uint32_t *from = data_stored;
    int failed;
    COPROCESSORS |= 0xfu << 20;
    __asm volatile("dsb\n\tisb");
    for (uint32_t *to = data_begin; to < data_end; ++to, ++from) {
        *to = *from;
    }
    for (uint32_t *to = bss_begin; to < bss_end; ++to) {
        *to = 0;
    }
    TIMER_RELOAD = 0xffffffffu;
    TIMER_VALUE = 0xffffffffu;
    TIMER_CONTROL = 1;
    initialise_monitor_handles();
    failed = main();
    if (steps == 0) {
        exit(failed);
    }
    printf("@{name} on a Cortex-M4F: %lu instructions in a step, at most %lu; %lu bytes of stack\n",
           (unsigned long)(all_instructions / steps), (unsigned long)most_instructions,
           (unsigned long)deepest);
    exit(failed);
}

static void fault(void)
{
    printf("@{name} on a Cortex-M4F: a fault of the processor\n");
    exit(1);
}

static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
} vectors __attribute__((section(".vectors"), used)) = {
    stack_top, {reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, 0, 0, 0, 0, tick}};
