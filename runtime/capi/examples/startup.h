/* The least that a Cortex-M4F program needs, without a board: vectors, a painted stack, the floating-point unit, and
   output and end by semihosting, which QEMU and debuggers understand (Arm, "Semihosting for AArch32", 2.0). */
#ifndef STARTUP_H
#define STARTUP_H

#include <stdint.h>

extern uint32_t stack_bottom[], stack_top[], data_start[], data_end[], data_stored[], bss_start[], bss_end[];

int main(void);

static int32_t semihosting(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return (int32_t)r0;
}

static void print(const char *text)
{
    semihosting(0x04 /* SYS_WRITE0 */, text);
}

static void stop(int succeeded)
{
    for (;;) {
        semihosting(0x18 /* SYS_EXIT */, (const void *)(succeeded ? 0x20026 /* ApplicationExit */ : 0x20023));
    }
}

#define PAINT 0xccccccccu

/* Paints the free stack; `stack_used` then says how deep it was used since, in bytes. */
static inline __attribute__((always_inline)) void paint_stack(void)
{
    volatile uint32_t *end;
    __asm__ volatile("mov %0, sp" : "=r"(end));
    for (volatile uint32_t *word = stack_bottom; word < end; word++) {
        *word = PAINT;
    }
}

static inline uint32_t stack_used(void)
{
    const volatile uint32_t *word = stack_bottom;
    while (word < stack_top && *word == PAINT) {
        word++;
    }
    return (uint32_t)((const char *)stack_top - (const char *)word);
}

void reset(void);

void reset(void)
{
    /* CPACR: full access to CP10 and CP11, before any instruction of theirs. */
    *(volatile uint32_t *)0xe000ed88 |= 0xfu << 20;
    __asm__ volatile("dsb\n isb" ::: "memory");
    const uint32_t *from = data_stored;
    for (uint32_t *to = data_start; to < data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0;
    }
    stop(main() == 0);
}

static void fault(void)
{
    print("fault\n");
    stop(0);
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
} vectors = {stack_top, {reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, fault}};

#endif
