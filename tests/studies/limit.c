/* What rendering cannot beat: the multiply-adds of the transforms alone, on every core, with neither classes nor encoding.

   cc -O3 -march=native -fopenmp -DPATCH=9 limit.c -o limit -lm && ./limit 1280 720

   Each line on stdin asks for one frame; its milliseconds are the answer on stdout. A row of the patch is one vector of 16,
   filled up with weights of zero; three outputs; classes as a smooth scene of 20 levels gives them. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { OUTPUTS = 3, LANES = 16, SITES = 16, LEVELS = 20, CONTRASTS = 2, CLASS = PATCH * OUTPUTS * LANES };

typedef float taps __attribute__((vector_size(4 * LANES)));
typedef float unaligned_taps __attribute__((vector_size(4 * LANES), aligned(4)));
typedef float half_taps __attribute__((vector_size(2 * LANES)));
typedef float quarter_taps __attribute__((vector_size(LANES)));

static float sum(taps v) {
    union { taps whole; half_taps half[2]; } in_halves = {v};
    union { half_taps whole; quarter_taps half[2]; } in_quarters = {in_halves.half[0] + in_halves.half[1]};
    const quarter_taps four = in_quarters.half[0] + in_quarters.half[1];
    return (four[0] + four[2]) + (four[1] + four[3]);
}

static void apply(const float *patch, long stride, const float *weights, float *output) {
    taps total[OUTPUTS] = {{0}};
    #pragma GCC unroll 16
    for (int row = 0; row < PATCH; row++) {
        const taps signal = *(const unaligned_taps *)(patch + row * stride);
        #pragma GCC unroll 3
        for (int o = 0; o < OUTPUTS; o++) total[o] += signal * *(const taps *)(weights + (row * OUTPUTS + o) * LANES);
    }
    for (int o = 0; o < OUTPUTS; o++) output[o] = sum(total[o]);
}

static void *aligned(size_t bytes) {
    void *memory = aligned_alloc(64, (bytes + 63) / 64 * 64);
    if (!memory) exit(1);
    return memory;
}

static double milliseconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1e3 + now.tv_nsec * 1e-6;
}

int main(int count, char **argument) {
    if (count != 3) return 2;
    const long width = atol(argument[1]), height = atol(argument[2]), stride = width + PATCH - 1 + LANES;
    const long padded = (height + PATCH) * stride, weight_count = (long)SITES * LEVELS * CONTRASTS * CLASS;
    float *mosaic = aligned(4 * padded), *weights = aligned(4 * weight_count), *output = aligned(4 * OUTPUTS * width * height);
    unsigned short *label = aligned(2 * width * height);
    for (long i = 0; i < padded; i++) mosaic[i] = rand() % 4096;
    for (long i = 0; i < weight_count; i++) weights[i] = rand() / (float)RAND_MAX - 0.5f;
    for (long y = 0; y < height; y++)
        for (long x = 0; x < width; x++) {
            const int level = LEVELS * (0.5 + 0.25 * sin(x * 0.01) + 0.24 * cos(y * 0.013));
            label[y * width + x] = ((y % 4 * 4 + x % 4) * LEVELS + level) * CONTRASTS + (rand() % 8 == 0);
        }
    while (getchar() != EOF) {
        const double start = milliseconds();
        #pragma omp parallel for schedule(dynamic, 16)
        for (long y = 0; y < height; y++)
            for (long x = 0; x < width; x++)
                apply(mosaic + y * stride + x, stride, weights + (long)label[y * width + x] * CLASS,
                      output + (y * width + x) * OUTPUTS);
        printf("%.4f\n", milliseconds() - start);
        fflush(stdout);
    }
    return 0;
}
