/* What both examples do: load a blob, evaluate and correct a list of commands, command a path, print the bits.

   Every line has the question, then " | ", then the answer; numbers of type float are printed as the eight hexadecimal
   digits of their bits, all others as such. No arithmetic here but exact steps of a path, so that no compiler can make a difference:

     evaluate JOINT … PAYLOAD | CODE STATUS BASE_FROM_TARGET[12] CORRECTION[6]
     correct JOINT … PAYLOAD | CODE STATUS JOINTS[8] APPLIED POSITION_ERROR ROTATION_ERROR
     command JOINT … PAYLOAD ENGAGE CYCLES | CODE STATUS JOINTS[8] WEIGHT APPLIED POSITION_ERROR ROTATION_ERROR DISENGAGED
     counts HELD LOST DOUBLED BAD GUARDED
     frame JOINT … PAYLOAD SEQUENCE | CODE LENGTH BYTE …
     answer BYTE … | CODE STATUS JOINTS[8] APPLIED POSITION_ERROR ROTATION_ERROR JOINT_COUNT SEQUENCE                 */
#ifndef ANSWERS_H
#define ANSWERS_H

#include <math.h> /* NAN and INFINITY: no function of it is used */
#include <string.h>

#include "poegp.h"

typedef void (*print_t)(const char *text);

struct command {
    size_t count;
    float joints[9]; /* rad */
    float payload_kg;
};

static const struct command commands[] = {
    {6, {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}, 0.0f}, /* the wrist is stretched: singular */
    {6, {0.3f, -0.2f, 0.4f, 0.1f, 0.7f, -0.5f}, 1.0f},
    {6, {-0.8f, 0.5f, -0.3f, 1.2f, -0.9f, 2.1f}, 2.5f},
    {6, {1.1f, 0.6f, 0.2f, -1.4f, 1.0f, -2.4f}, 5.0f},
    {6, {-1.3f, -0.4f, 0.5f, 0.9f, 0.8f, 0.05f}, 1.7f},
    {6, {0.02f, 0.9f, -0.6f, -0.3f, -1.1f, 1.5f}, 4.2f},
    {6, {0.6f, 0.1f, 0.1f, 2.0f, 0.3f, -1.0f}, 0.4f},
    {6, {-0.45f, -0.7f, 0.8f, -2.2f, 1.3f, 0.7f}, 3.3f},
    {6, {0.9f, 0.33f, -0.12f, 0.5f, 0.01f, 3.0f}, 2.0f}, /* close to a singular pose */
    {6, {2.9f, 1.6f, 1.2f, 3.4f, 2.1f, -6.0f}, 60.0f},   /* outside of what was trained */
    {6, {4096.0f, -4096.0f, 4096.0f, -4096.0f, 4096.0f, -4096.0f}, 100000.0f},
    /* questions that are none */
    {6, {0.1f, NAN, 0.3f, 0.4f, 0.5f, 0.6f}, 1.0f},
    {6, {0.1f, 0.2f, 0.3f, INFINITY, 0.5f, 0.6f}, 1.0f},
    {6, {0.1f, 0.2f, 0.3f, 0.4f, 0.5f, -1e30f}, 1.0f},
    {6, {0.1f, 0.2f, 0.3f, 0.4f, 0.5f, 0.6f}, NAN},
    {6, {0.1f, 0.2f, 0.3f, 0.4f, 0.5f, 0.6f}, -1.0f},
    {5, {0.1f, 0.2f, 0.3f, 0.4f, 0.5f}, 1.0f},
    {9, {0.1f, 0.2f, 0.3f, 0.4f, 0.5f, 0.6f, 0.7f, 0.8f, 0.9f}, 1.0f},
    {0, {0.0f}, 1.0f},
};

static inline void print_hex(print_t print, uint32_t word)
{
    char text[10] = " ";
    for (int digit = 0; digit < 8; digit++) {
        text[1 + digit] = "0123456789abcdef"[(word >> (28 - 4 * digit)) & 15];
    }
    print(text);
}

static inline void print_number(print_t print, uint32_t number)
{
    char text[12];
    int at = sizeof text - 1;
    text[at] = '\0';
    do {
        text[--at] = (char)('0' + number % 10);
        number /= 10;
    } while (number != 0);
    text[--at] = ' ';
    print(&text[at]);
}

static inline void print_bits(print_t print, const float *values, size_t count)
{
    for (size_t index = 0; index < count; index++) {
        uint32_t bits;
        memcpy(&bits, &values[index], sizeof bits);
        print_hex(print, bits);
    }
}

static inline void print_question(print_t print, const char *verb, const struct command *command)
{
    print(verb);
    print_bits(print, command->joints, command->count);
    print_bits(print, &command->payload_kg, 1);
}

static inline void print_answer(print_t print, int32_t code, uint32_t status)
{
    print(" |");
    print_number(print, (uint32_t)code);
    print_number(print, status);
}

static inline void show_answers(const poegp_model_t *model, print_t print)
{
    for (size_t index = 0; index < sizeof commands / sizeof commands[0]; index++) {
        const struct command *command = &commands[index];

        poegp_evaluation_t evaluation;
        int32_t code = poegp_evaluate(model, command->joints, command->count, command->payload_kg, &evaluation);
        print_question(print, "evaluate", command);
        print_answer(print, code, evaluation.status);
        print_bits(print, evaluation.base_from_target, 12);
        print_bits(print, evaluation.correction, 6);
        print("\n");

        poegp_corrected_t corrected;
        code = poegp_correct(model, command->joints, command->count, command->payload_kg, &corrected);
        print_question(print, "correct", command);
        print_answer(print, code, corrected.status);
        print_bits(print, corrected.joints, POEGP_MAX_JOINTS);
        print_bits(print, &corrected.applied, 1);
        print_bits(print, &corrected.position_error, 1);
        print_bits(print, &corrected.rotation_error, 1);
        print("\n");
    }
}

/* A path that is switched, loses commands and has some that are none. */
static inline void show_commands(const poegp_model_t *model, poegp_filter_t *filter, print_t print)
{
    for (uint32_t cycle = 0; cycle < 160; cycle++) {
        struct command command = commands[1];
        for (size_t joint = 0; joint < command.count; joint++) {
            command.joints[joint] += (float)cycle / 1024.0f;
        }
        if (cycle % 29 == 28) {
            command.joints[2] = NAN;
        }
        if (cycle >= 30) {
            command.payload_kg = 4.0f;
        }
        int32_t engage = cycle < 60 || cycle >= 120;
        uint32_t cycles = cycle % 41 == 40 ? 9 : cycle % 37 == 36 ? 0 : 1;

        poegp_commanded_t commanded;
        int32_t code = poegp_command(model, filter, command.joints, command.count, command.payload_kg, engage, cycles,
                                     &commanded);
        print_question(print, "command", &command);
        print_number(print, (uint32_t)engage);
        print_number(print, cycles);
        print_answer(print, code, commanded.status);
        print_bits(print, commanded.joints, POEGP_MAX_JOINTS);
        print_bits(print, &commanded.weight, 1);
        print_bits(print, &commanded.applied, 1);
        print_bits(print, &commanded.position_error, 1);
        print_bits(print, &commanded.rotation_error, 1);
        print_number(print, (uint32_t)poegp_filter_disengaged(filter));
        print("\n");
    }
    poegp_filter_counts_t counts;
    poegp_filter_counts(filter, &counts);
    print("counts");
    print_number(print, counts.held);
    print_number(print, counts.lost);
    print_number(print, counts.doubled);
    print_number(print, counts.bad);
    print_number(print, counts.guarded);
    print("\n");
}

/* The answer of a device in a cyclic frame. */
static const uint8_t answer_frame[] = {
    0x05, 0x81, 0x34, 0x12, 0x21, 0x01, 0x1b, 0x40, 0x3f, 0xac, 0xc5, 0x27, 0x37, 0xac, 0xc5, 0xa7,
    0x37, 0xcd, 0xcc, 0xcc, 0x3d, 0xcd, 0xcc, 0x4c, 0xbe, 0x9a, 0x99, 0x99, 0x3e, 0xcd, 0xcc, 0xcc,
    0xbe, 0x01, 0x01, 0x0a, 0x3f, 0x9a, 0x99, 0x19, 0xbf, 0xe1, 0x4c, 0x2b, 0x7d, 0x00,
};

static inline void print_bytes(print_t print, const uint8_t *bytes, size_t count)
{
    for (size_t index = 0; index < count; index++) {
        print_number(print, bytes[index]);
    }
}

/* What a controller sends to a device and gets from it. */
static inline void show_frames(print_t print)
{
    for (size_t index = 0; index < sizeof commands / sizeof commands[0]; index++) {
        const struct command *command = &commands[index];
        uint16_t sequence = (uint16_t)(index * 3847);
        uint8_t frame[POEGP_CYCLIC_BYTES];
        size_t length;
        int32_t code = poegp_cyclic_command(sequence, command->joints, command->count, command->payload_kg, frame,
                                            &length);
        print_question(print, "frame", command);
        print_number(print, sequence);
        print_answer(print, code, (uint32_t)length);
        print_bytes(print, frame, length);
        print("\n");
    }
    for (size_t damage = 0; damage < 3; damage++) {
        uint8_t frame[sizeof answer_frame];
        memcpy(frame, answer_frame, sizeof frame);
        size_t length = sizeof frame - (damage == 1); /* without its zero */
        frame[10] ^= damage == 2;
        poegp_cyclic_answer_t answer;
        memset(&answer, 0, sizeof answer);
        int32_t code = poegp_cyclic_answer(frame, length, &answer);
        print("answer");
        print_bytes(print, frame, length);
        print_answer(print, code, answer.status);
        print_bits(print, answer.joints, POEGP_MAX_JOINTS);
        print_bits(print, &answer.applied, 1);
        print_bits(print, &answer.position_error, 1);
        print_bits(print, &answer.rotation_error, 1);
        print_number(print, answer.joint_count);
        print_number(print, answer.sequence);
        print("\n");
    }
}

/* Says what is wrong, if anything is. */
static inline int is_error(int32_t code, print_t print)
{
    if (code == POEGP_OK) {
        return 0;
    }
    print("error");
    print_number(print, (uint32_t)code);
    print(": ");
    print(poegp_error_text(code));
    print("\n");
    return 1;
}

/* Initialises a model, loads the blob and says whose it is; null when something is wrong, which is printed. */
static inline poegp_model_t *load(void *memory, size_t bytes, const uint8_t *blob, size_t length, print_t print)
{
    poegp_model_t *model;
    int32_t code = poegp_api_version() == POEGP_API_VERSION ? POEGP_OK : POEGP_ERROR_OTHER;
    if (code == POEGP_OK) {
        code = poegp_init(memory, bytes, &model);
    }
    if (code == POEGP_OK) {
        code = poegp_load(model, blob, length);
    }
    if (is_error(code, print)) {
        return NULL;
    }
    poegp_identity_t identity;
    poegp_identify(model, &identity);
    print("robot ");
    print(identity.robot);
    print(", crc");
    print_hex(print, identity.blob_crc);
    print(", joints");
    print_number(print, identity.joints);
    print(", inducing points");
    print_number(print, identity.inducing_points);
    print("\n");
    return model;
}

/* Makes a filter for 20 commands a second; null when something is wrong, which is printed. */
static inline poegp_filter_t *make_filter(void *memory, size_t bytes, print_t print)
{
    poegp_filter_t *filter;
    poegp_filter_settings_t settings;
    int32_t code = poegp_filter_defaults(0.05f, &settings);
    if (code == POEGP_OK) {
        code = poegp_filter_init(memory, bytes, &settings, &filter);
    }
    return is_error(code, print) ? NULL : filter;
}

#endif
