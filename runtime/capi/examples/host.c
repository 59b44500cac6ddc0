/* The workstation's example: `host ARM.blob` prints the bits of what the library answers. README.md says how to build. */
#include <stdio.h>

#include "answers.h"

static _Alignas(POEGP_MODEL_ALIGN) unsigned char memory[POEGP_MODEL_BYTES];
static _Alignas(POEGP_FILTER_ALIGN) unsigned char filter_memory[POEGP_FILTER_BYTES];
static uint8_t blob[65536];

static void print(const char *text)
{
    fputs(text, stdout);
}

int main(int count, char **arguments)
{
    FILE *file = count == 2 ? fopen(arguments[1], "rb") : NULL;
    if (file == NULL) {
        fputs("usage: host ARM.blob\n", stderr);
        return 2;
    }
    size_t length = fread(blob, 1, sizeof blob, file);
    fclose(file);
    const poegp_model_t *model = load(memory, sizeof memory, blob, length, print);
    poegp_filter_t *filter = make_filter(filter_memory, sizeof filter_memory, print);
    if (model == NULL || filter == NULL) {
        return 1;
    }
    show_answers(model, print);
    show_commands(model, filter, print);
    show_frames(print);
    return 0;
}
