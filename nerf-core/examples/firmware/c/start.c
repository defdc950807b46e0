/* What runs before main: the vector table, and RAM as C expects it. For any Cortex-M with an FPU. */
#include <stdint.h>

extern uint32_t stack_top[], stack_bottom[], data_from[], data_start[], data_end[], bss_start[], bss_end[];

int main(void);

static void stop(void) {
    for (;;) { /* a debugger says where */
    }
}

__attribute__((noreturn)) void reset(void);

void reset(void) {
    /* Full access to the FPU (CPACR), before the first float. */
    *(volatile uint32_t *)0xe000ed88 |= 0xfu << 20;
    __asm__ volatile("dsb\n isb" ::: "memory");
    /* Paint what no function has used yet, so that main can say how far the stack went. */
    for (volatile uint32_t *at = stack_bottom; at < (uint32_t *)__builtin_frame_address(0) - 16; ++at) *at = 0xcccccccc;
    for (volatile uint32_t *at = bss_start; at < bss_end; ++at) *at = 0;
    uint32_t *from = data_from;
    for (volatile uint32_t *at = data_start; at < data_end; ++at) *at = *from++;
    main();
    stop();
    __builtin_unreachable();
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
} vectors = {stack_top, {reset, stop, stop, stop, stop, stop, 0, 0, 0, 0, stop, stop, 0, stop, stop}};
