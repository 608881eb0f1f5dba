// Processor variant: chroma as shading would make it (l3cli/classes/refinement.py), of a row of a tile: taps behind the window of a
// last layer with RATIO_TAPS.

#ifdef RATIO_TAPS
typedef struct {
    int sum[SOURCES][SPAN];  // of each plane down a column
    float luminance[SPAN];   // of the row itself
    float chroma[RATIO_TAPS][SPAN];  // the taps, those of the tile's first column first
} WindowSums;

INLINE floats ratio_of(floats luminance, floats total) {
    const float count = PATCH * PATCH;
    const floats least = count * DARKEST, share = (count * luminance - total) / (total > least ? total : least);
    const floats below = share < 1.0f ? share : (floats)1.0f;
    return below > -1.0f ? below : (floats)-1.0f;
}

// Of the row whose window begins in padded row `rows[0]`; the tile's first column is x0.
INLINE void sum_windows(WindowSums *to, __global const int *planes, __global const int *rows, __global const int *column_source, int x0,
                        int width, int columns, size_t stride) {
    const int first = max(0, RADIUS - x0), end = width + 2 * RADIUS, last = min(end, columns - x0 + RADIUS);
    for (int s = 0; s < SOURCES; s++) {
        __global const int *plane = planes + s * stride + x0 - RADIUS;
        int p = first;
        for (; p + LANES <= last; p += LANES) {
            ints sum = 0;
            #pragma unroll
            for (int j = 0; j < PATCH; j++) sum += LOAD_GLOBAL(ints, plane + (size_t)rows[j] * columns + p);
            STORE_PRIVATE(ints, to->sum[s] + p) = sum;
        }
        AT_EDGE
        for (; p < last; p++) {
            int sum = 0;
            for (int j = 0; j < PATCH; j++) sum += plane[(size_t)rows[j] * columns + p];
            to->sum[s][p] = sum;
        }
        AT_EDGE
        for (int i = 0; i < first; i++) to->sum[s][i] = to->sum[s][column_source[x0 + i] - x0 + RADIUS];
        AT_EDGE
        for (; p < end; p++) to->sum[s][p] = to->sum[s][column_source[x0 + p] - x0 + RADIUS];
    }
    __global const int *own = planes + LUMINANCE * stride + (size_t)rows[RADIUS] * columns + x0;
    int p = 0;
    for (; p + LANES <= width; p += LANES) STORE_PRIVATE(floats, to->luminance + p) = CONVERT(LOAD_GLOBAL(ints, own + p), floats);
    AT_EDGE
    for (; p < width; p++) to->luminance[p] = own[p];
    for (int x = 0; x < width; x += LANES) {
        floats total[SOURCES];
        #pragma unroll
        for (int s = 0; s < SOURCES; s++) {
            ints sum = 0;
            #pragma unroll
            for (int i = 0; i < PATCH; i++) sum += LOAD_PRIVATE(ints, to->sum[s] + x + i);
            total[s] = CONVERT(sum, floats);
        }
        const floats share = ratio_of(LOAD_PRIVATE(floats, to->luminance + x), total[LUMINANCE]) * (1.0f / (PATCH * PATCH));
        STORE_PRIVATE(floats, to->chroma[0] + x) = total[0] * share;
        STORE_PRIVATE(floats, to->chroma[1] + x) = total[SOURCES - 1] * share;
    }
}
#define BEHIND(sums) (sums).chroma[0]
#else
#define BEHIND(sums) 0
#endif
