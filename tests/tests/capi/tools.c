/* A path of joints in double precision with the C functions: prints every answer as bits, then the times. */
#define _POSIX_C_SOURCE 199309L

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "poegp.h"

static _Alignas(POEGP_MODEL_ALIGN) unsigned char memory[POEGP_MODEL_F64_BYTES];
static _Alignas(POEGP_FILTER_ALIGN) unsigned char filter_memory[POEGP_FILTER_F64_BYTES];
static uint8_t blob[65536];

static const double tool[12] = {0.0, -1.0, 0.0, 0.05, 1.0, 0.0, 0.0, -0.1, 0.0, 0.0, 1.0, 0.2};

static void print_bits(const double *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        printf(" %016llx", (unsigned long long)bits);
    }
}

static void question(const char *verb, const double *joints, const double *more, size_t count)
{
    double payload_kg = 2.0;
    printf("%s", verb);
    print_bits(joints, 6);
    print_bits(&payload_kg, 1);
    print_bits(more, count);
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double now_ns(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return 1e9 * (double)time.tv_sec + (double)time.tv_nsec;
}

static void joints_at(int cycle, double joints[6])
{
    static const double start[6] = {0.3, -0.2, 0.4, 0.1, 0.7, -0.5};
    for (int i = 0; i < 6; i++) {
        joints[i] = start[i] + (i % 2 == 0 ? 1.0 : -1.0) * (double)cycle / 1024.0;
    }
}

int main(int count, char **arguments)
{
    FILE *file = count == 2 ? fopen(arguments[1], "rb") : NULL;
    size_t length = file == NULL ? 0 : fread(blob, 1, sizeof blob, file);
    poegp_model_f64_t *model;
    poegp_filter_f64_t *filter;
    poegp_filter_settings_f64_t settings;
    if (poegp_init_f64(memory, sizeof memory, &model) != POEGP_OK || poegp_load_f64(model, blob, length) != POEGP_OK ||
        poegp_filter_defaults_f64(0.01, &settings) != POEGP_OK ||
        poegp_filter_init_f64(filter_memory, sizeof filter_memory, &settings, &filter) != POEGP_OK) {
        return 1;
    }
    double seed[6], joints[6];
    joints_at(0, seed);
    for (int cycle = 0; cycle < 100; cycle++) {
        joints_at(cycle, joints);

        poegp_forward_f64_t forward;
        int32_t code = poegp_forward_f64(model, tool, joints, 6, 2.0, &forward);
        question("forward", joints, NULL, 0);
        printf(" | %d %u", (int)code, (unsigned)forward.status);
        print_bits(forward.base_from_tool, 12);
        print_bits(&forward.trust, 1);
        printf("\n");

        poegp_jacobian_f64_t jacobian;
        code = poegp_jacobian_f64(model, tool, joints, 6, 2.0, &jacobian);
        question("jacobian", joints, NULL, 0);
        printf(" | %d %u", (int)code, (unsigned)jacobian.status);
        for (int row = 0; row < 6; row++) {
            print_bits(jacobian.rows[row], POEGP_MAX_JOINTS);
        }
        printf("\n");

        poegp_inverse_f64_t inverse;
        code = poegp_inverse_f64(model, tool, forward.base_from_tool, seed, 6, 2.0, &inverse);
        question("inverse", seed, forward.base_from_tool, 12);
        printf(" | %d %u", (int)code, (unsigned)inverse.status);
        print_bits(inverse.joints, POEGP_MAX_JOINTS);
        print_bits(&inverse.position_error, 1);
        print_bits(&inverse.rotation_error, 1);
        printf("\n");
        memcpy(seed, inverse.joints, sizeof seed);

        poegp_corrected_f64_t corrected;
        code = poegp_correct_f64(model, joints, 6, 2.0, &corrected);
        question("correct", joints, NULL, 0);
        printf(" | %d %u", (int)code, (unsigned)corrected.status);
        print_bits(corrected.joints, POEGP_MAX_JOINTS);
        print_bits(&corrected.applied, 1);
        print_bits(&corrected.position_error, 1);
        print_bits(&corrected.rotation_error, 1);
        printf("\n");

        poegp_commanded_f64_t commanded;
        code = poegp_command_f64(model, filter, joints, 6, 2.0, 1, 1, &commanded);
        question("command", joints, NULL, 0);
        printf(" | %d %u", (int)code, (unsigned)commanded.status);
        print_bits(commanded.joints, POEGP_MAX_JOINTS);
        print_bits(&commanded.weight, 1);
        printf("\n");
    }

    /* Cycles at 1 kHz and 1 rad/s; the inverse of each starts from the joints of the one before. */
    enum { CYCLES = 400, ROUNDS = 20 };
    static double inverse_ns[CYCLES], forward_ns[CYCLES];
    double best_inverse = 1e9, best_forward = 1e9;
    for (int round = 0; round < ROUNDS; round++) {
        joints_at(0, seed);
        for (int cycle = 0; cycle < CYCLES; cycle++) {
            poegp_forward_f64_t forward;
            poegp_inverse_f64_t inverse;
            joints_at(cycle, joints);
            double start = now_ns();
            poegp_forward_f64(model, tool, joints, 6, 2.0, &forward);
            double between = now_ns();
            poegp_inverse_f64(model, tool, forward.base_from_tool, seed, 6, 2.0, &inverse);
            double end = now_ns();
            memcpy(seed, inverse.joints, sizeof seed);
            forward_ns[cycle] = between - start;
            inverse_ns[cycle] = end - between;
        }
        qsort(inverse_ns, CYCLES, sizeof inverse_ns[0], by_size);
        qsort(forward_ns, CYCLES, sizeof forward_ns[0], by_size);
        best_inverse = inverse_ns[CYCLES / 2] < best_inverse ? inverse_ns[CYCLES / 2] : best_inverse;
        best_forward = forward_ns[CYCLES / 2] < best_forward ? forward_ns[CYCLES / 2] : best_forward;
    }
    printf("median ns %.0f %.0f\n", best_forward, best_inverse);
    return 0;
}
