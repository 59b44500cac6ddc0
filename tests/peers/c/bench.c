/* The paper's Gaussian process in C with newlib's expf, and the static library, on the same questions in one run.
   README.md says what is compared. Prints a line for each question: ticks of the peer, ticks of ours, status, then the
   bits of both results. */
#include <math.h>

#include "answers.h"
#include "startup.h"

#define POINTS 300
#define INPUTS 7
#define OUTPUTS 6

__asm__(".section .rodata.model,\"a\"\n"
        ".balign 4\n"
        "blob: .incbin \"model.blob\"\n"
        "blob_end:\n"
        ".balign 4\n"
        "peer: .incbin \"peer.bin\"\n"
        "questions: .incbin \"questions.bin\"\n"
        "questions_end:\n"
        ".section .note.GNU-stack,\"\",%progbits\n"
        ".text\n");
extern const uint8_t blob[], blob_end[];
extern const float questions[][INPUTS], questions_end[];

/* scale: reciprocal length scales, so that k = exp(-|scale x - u|^2); affine: constant and slopes of each output. */
extern const struct {
    float scale[INPUTS];
    float affine[OUTPUTS][1 + INPUTS];
    struct {
        float u[INPUTS];
        float weight[OUTPUTS];
    } rows[POINTS];
} peer;

static _Alignas(POEGP_MODEL_ALIGN) unsigned char memory[POEGP_MODEL_BYTES];

__attribute__((noinline)) static void peer_mean(const float x[INPUTS], float mean[OUTPUTS])
{
    float scaled[INPUTS];
    for (int d = 0; d < INPUTS; d++) {
        scaled[d] = x[d] * peer.scale[d];
    }
    /* On the stack of this function alone, so that the compiler may keep them in registers. */
    float sums[OUTPUTS];
    for (int c = 0; c < OUTPUTS; c++) {
        sums[c] = peer.affine[c][0];
        for (int d = 0; d < INPUTS; d++) {
            sums[c] += peer.affine[c][1 + d] * x[d];
        }
    }
    for (int j = 0; j < POINTS; j++) {
        float squares = 0.0f;
        for (int d = 0; d < INPUTS; d++) {
            float difference = scaled[d] - peer.rows[j].u[d];
            squares += difference * difference;
        }
        float kernel = expf(-squares);
        for (int c = 0; c < OUTPUTS; c++) {
            sums[c] += kernel * peer.rows[j].weight[c];
        }
    }
    for (int c = 0; c < OUTPUTS; c++) {
        mean[c] = sums[c];
    }
}

/* APB timer 0 of the MPS2 counts down with 25 MHz. */
static volatile uint32_t *const timer = (volatile uint32_t *)0x40000000;

static uint32_t ticks(void)
{
    return -timer[1];
}

int main(void)
{
    timer[2] = 0xffffffff;
    timer[1] = 0xffffffff;
    timer[0] = 1;
    const poegp_model_t *model = load(memory, sizeof memory, blob, (size_t)(blob_end - blob), print);
    if (model == NULL) {
        return 1;
    }
    for (const float(*x)[INPUTS] = questions; (const float *)x < questions_end; x++) {
        float mean[OUTPUTS];
        uint32_t start = ticks();
        peer_mean(*x, mean);
        uint32_t of_peer = ticks() - start;

        poegp_evaluation_t evaluation;
        start = ticks();
        poegp_evaluate(model, *x, INPUTS - 1, (*x)[INPUTS - 1], &evaluation);
        uint32_t of_ours = ticks() - start;

        print("ticks");
        print_number(print, of_peer);
        print_number(print, of_ours);
        print_number(print, evaluation.status);
        print_bits(print, mean, OUTPUTS);
        print_bits(print, evaluation.correction, OUTPUTS);
        print("\n");
    }
    return 0;
}
