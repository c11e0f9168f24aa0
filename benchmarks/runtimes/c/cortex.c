/* Runs the self-test of a C form on a Cortex-M7: start-up, and what every step takes.

   The linker leads calls of holdfast_step_valid here (--wrap). One instruction takes one ns of
   QEMU's time (-icount shift=0), and SysTick counts at 25 MHz: 40 instructions a tick. */
#include "holdfast.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TICK_INSTRUCTIONS = 40, TICKS = 1 << 24, PAINTED = 64 * 1024, PAINT = 0xA5, ACCESS_FPU = 0xF << 20 };

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SYSTICK_CONTROL REGISTER(0xE000E010u)
#define SYSTICK_RELOAD REGISTER(0xE000E014u)
#define SYSTICK_NOW REGISTER(0xE000E018u)
#define COPROCESSORS REGISTER(0xE000ED88u)

extern uint32_t data_from[], data_begin[], data_end[], bss_begin[], bss_end[], stack_top[];
extern void initialise_monitor_handles(void);
extern int main(void);
int __real_holdfast_step_valid(holdfast_state *, const double *, const uint8_t *, holdfast_out *);

static uint64_t all_ticks;
static uint32_t steps, most_ticks, most_stack;

static void report(void) {
    printf("steps %lu instructions %lu most %lu stack %lu state %lu out %lu\n", (unsigned long)steps,
           (unsigned long)(all_ticks * TICK_INSTRUCTIONS / steps),
           (unsigned long)(most_ticks * TICK_INSTRUCTIONS), (unsigned long)most_stack,
           (unsigned long)sizeof(holdfast_state), (unsigned long)sizeof(holdfast_out));
}

/* Bytes below the caller's frame that a step has written to. */
static uint32_t unpainted(const uint8_t *low) {
    uint32_t k = 0;
    while (k < PAINTED && low[k] == PAINT) ++k;
    return PAINTED - k;
}

int __wrap_holdfast_step_valid(holdfast_state *state, const double *sample, const uint8_t *valid,
                               holdfast_out *out) {
    uint8_t *low = (uint8_t *)__builtin_frame_address(0) - PAINTED - 128;
    uint32_t begin, ticks, stack;
    int code;
    for (uint32_t k = 0; k < PAINTED; ++k) ((volatile uint8_t *)low)[k] = PAINT;
    begin = SYSTICK_NOW;
    code = __real_holdfast_step_valid(state, sample, valid, out);
    ticks = (begin - SYSTICK_NOW) & (TICKS - 1);
    stack = unpainted(low) + 128;
    steps += 1;
    all_ticks += ticks;
    if (ticks > most_ticks) most_ticks = ticks;
    if (stack > most_stack) most_stack = stack;
    return code;
}

void reset(void) {
    COPROCESSORS |= ACCESS_FPU;
    memcpy(data_begin, data_from, (size_t)((uint8_t *)data_end - (uint8_t *)data_begin));
    memset(bss_begin, 0, (size_t)((uint8_t *)bss_end - (uint8_t *)bss_begin));
    SYSTICK_RELOAD = TICKS - 1;
    SYSTICK_NOW = 0;
    SYSTICK_CONTROL = 5;
    initialise_monitor_handles();
    atexit(report);
    exit(main());
}

__attribute__((section(".vectors"), used)) static const void *const vectors[2] = {stack_top, (const void *)reset};
