/* What both examples do: load a blob, evaluate and correct a list of commands, print the bits.

   Every line has the question, then " | ", then the answer; numbers of type float are printed as the eight hexadecimal
   digits of their bits, all others as such. No arithmetic here, so that no compiler can make a difference:

     evaluate JOINT … PAYLOAD | CODE STATUS BASE_FROM_TARGET[12] CORRECTION[6]
     correct JOINT … PAYLOAD | CODE STATUS JOINTS[8] POSITION_ERROR                                                  */
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

static inline void print_answer(print_t print, const char *verb, const struct command *command, int32_t code, uint32_t status)
{
    print(verb);
    print_bits(print, command->joints, command->count);
    print_bits(print, &command->payload_kg, 1);
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
        print_answer(print, "evaluate", command, code, evaluation.status);
        print_bits(print, evaluation.base_from_target, 12);
        print_bits(print, evaluation.correction, 6);
        print("\n");

        poegp_corrected_t corrected;
        code = poegp_correct(model, command->joints, command->count, command->payload_kg, &corrected);
        print_answer(print, "correct", command, code, corrected.status);
        print_bits(print, corrected.joints, POEGP_MAX_JOINTS);
        print_bits(print, &corrected.position_error, 1);
        print("\n");
    }
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
    if (code != POEGP_OK) {
        print("error");
        print_number(print, (uint32_t)code);
        print(": ");
        print(poegp_error_text(code));
        print("\n");
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
    print(", support");
    print_number(print, identity.support);
    print("\n");
    return model;
}

#endif
