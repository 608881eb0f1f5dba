/* Without arguments, the program renders test_raw.bin and compares the results with test_labels.bin and test_outputs.bin. It exits with 1
 * if a class differs, if a float differs by more than 2e-6 of the largest output, or if a 16-bit output differs by more than
 * L3_TEST_STEPS from the rounded output. If chroma is smoothed, a float may differ by 1e-5, because the weights of the smoothing amplify
 * rounding errors. With the arguments ROWS COLUMNS, it measures the time to render frames of this size, filled with the test mosaic. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "l3.h"

#define FRAMES 10
#define PIXELS ((size_t)L3_TEST_ROWS * L3_TEST_COLUMNS)

static void *room(size_t bytes) {
    void *memory = malloc(bytes);
    if (memory == NULL) fprintf(stderr, "not enough memory\n"), exit(2);
    return memory;
}

/* Reads a file of `bytes` bytes. */
static unsigned char *read_file(const char *name, size_t bytes) {
    unsigned char *content = room(bytes);
    FILE *file = fopen(name, "rb");
    if (file == NULL || fread(content, 1, bytes, file) != bytes) fprintf(stderr, "%s is missing or too short\n", name), exit(2);
    fclose(file);
    return content;
}

static uint32_t word(const unsigned char *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Reads a little-endian IEEE 754 float, on any processor. */
static double number(const unsigned char *at) {
    const union { uint32_t bits; float value; } same = {word(at)};
    return (double)same.value;
}

static uint16_t *test_mosaic(void) {
    unsigned char *bytes = read_file("test_raw.bin", PIXELS * 2);
    uint16_t *raw = room(PIXELS * sizeof *raw);
    for (size_t i = 0; i < PIXELS; i++) raw[i] = (uint16_t)(bytes[2 * i] | bytes[2 * i + 1] << 8);
    free(bytes);
    return raw;
}

static double size_of(double value) { return value < 0 ? -value : value; }

#ifdef L3_BY_LUMINANCE /* chroma is smoothed */
#define MOST_SHARE 1e-5
#else
#define MOST_SHARE 2e-6
#endif

#if L3_OUTPUT_FRACTION > 0 /* 16-bit outputs: converts the output of the reference to steps */
#define TOLERANCE(largest) (L3_TEST_STEPS + 0 * (largest))
static double in_steps(double output) {
    const double steps = output * (1 << L3_OUTPUT_FRACTION) + (output < 0 ? -0.5 : 0.5);
    return steps > L3_OUTPUT_TOP ? L3_OUTPUT_TOP : steps < -L3_OUTPUT_TOP ? -L3_OUTPUT_TOP : (double)(long)steps;
}
#else
#define TOLERANCE(largest) (MOST_SHARE * (largest))
static double in_steps(double output) { return output; }
#endif

static int compare(void) {
    uint16_t *raw = test_mosaic();
    unsigned char *labels = read_file("test_labels.bin", L3_LAYERS * PIXELS * 4);
    unsigned char *outputs = read_file("test_outputs.bin", L3_OUTPUTS * PIXELS * 4);
    uint32_t *label = room(L3_LAYERS * PIXELS * sizeof *label);
    L3Output *output = room(L3_OUTPUTS * PIXELS * sizeof *output);
    void *workspace = room(l3_workspace_bytes(L3_TEST_ROWS, L3_TEST_COLUMNS));
    if (l3_render(raw, L3_TEST_ROWS, L3_TEST_COLUMNS, L3_TEST_PHASE_ROW, L3_TEST_PHASE_COLUMN, workspace, label, output) != 0)
        return 2;
    unsigned long differing = 0;
    double most = 0, largest = 0;
    for (size_t i = 0; i < L3_LAYERS * PIXELS; i++) differing += label[i] != word(labels + 4 * i);
    for (size_t i = 0; i < L3_OUTPUTS * PIXELS; i++) {
        const double expected = in_steps(number(outputs + 4 * i)), difference = size_of((double)output[i] - expected);
        most = difference > most ? difference : most;
        largest = size_of(expected) > largest ? size_of(expected) : largest;
    }
    printf("classes that differ: %lu of %lu; largest difference of an output: %.2g (largest output: %.2g)\n", differing,
           (unsigned long)(L3_LAYERS * PIXELS), most, largest);
    free(raw), free(labels), free(outputs), free(label), free(output), free(workspace);
    return differing > 0 || !(most <= TOLERANCE(largest));
}

static int measure(int rows, int columns) {
    const size_t bytes = l3_workspace_bytes(rows, columns), pixels = (size_t)rows * (size_t)columns;
    if (rows < 1 || columns < 1 || bytes == 0) return fprintf(stderr, "frames of this size cannot be rendered\n"), 2;
    uint16_t *test = test_mosaic(), *raw = room(pixels * sizeof *raw);
    uint32_t *label = room(L3_LAYERS * pixels * sizeof *label);
    L3Output *output = room(L3_OUTPUTS * pixels * sizeof *output);
    void *workspace = room(bytes);
    for (size_t i = 0; i < pixels; i++)
        raw[i] = test[i / (size_t)columns % L3_TEST_ROWS * L3_TEST_COLUMNS + i % (size_t)columns % L3_TEST_COLUMNS];
    double fastest = 1e9;
    for (int frame = 0; frame < FRAMES; frame++) {
        const clock_t start = clock();
        if (l3_render(raw, rows, columns, 0, 0, workspace, label, output) != 0) return 2;
        const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
        fastest = seconds < fastest ? seconds : fastest;
    }
    printf("%d x %d: %.1f ms per frame on one core (fastest of %d); workspace %.1f MB\n", columns, rows, 1e3 * fastest, FRAMES,
           (double)bytes / 1e6);
    free(test), free(raw), free(label), free(output), free(workspace);
    return 0;
}

int main(int count, char **arguments) {
    if (count == 1) return compare();
    if (count == 3) return measure(atoi(arguments[1]), atoi(arguments[2]));
    fprintf(stderr, "usage: l3_test [ROWS COLUMNS]\n");
    return 2;
}
