/* The controller's example: a Cortex-M4F without an operating system, here in QEMU. The blob lies in flash. README.md
   says how to build. */
#include "answers.h"
#include "startup.h"

__asm__(".section .rodata.blob,\"a\"\n"
        "blob: .incbin \"arm.blob\"\n"
        "blob_end:\n"
        ".section .note.GNU-stack,\"\",%progbits\n"
        ".text\n");
extern const uint8_t blob[], blob_end[];

static _Alignas(POEGP_MODEL_ALIGN) unsigned char memory[POEGP_MODEL_BYTES];
static _Alignas(POEGP_FILTER_ALIGN) unsigned char filter_memory[POEGP_FILTER_BYTES];

int main(void)
{
    paint_stack();
    const poegp_model_t *model = load(memory, sizeof memory, blob, (size_t)(blob_end - blob), print);
    poegp_filter_t *filter = make_filter(filter_memory, sizeof filter_memory, print);
    if (model == NULL || filter == NULL) {
        return 1;
    }
    uint32_t loading = stack_used();
    paint_stack();
    show_answers(model, print);
    show_commands(model, filter, print);
    show_frames(print);
    print("stack");
    print_number(print, loading);
    print_number(print, stack_used());
    print("\n");
    return 0;
}
