// Processor variant: what a last layer reads behind its windows, of a row of a tile: chroma as shading would make it
// (SHADED_CHROMA, l3cli/classes/refinement.py), then what coarse chroma changes (COARSE_CHROMA, l3cli/classes/coarse_chroma.py).

#ifdef RATIO_TAPS

typedef struct {
    int sum[SOURCES][SPAN];          // of each plane down a column
    int near[SPAN];                  // luminance of three rows, 1 2 1
    float luminance[SPAN];           // of the row itself
    float chroma[RATIO_TAPS][SPAN];  // what is made of them; the first lies at the tile's first column
} Ratios;

#ifdef SHADED_CHROMA
INLINE floats ratio_of(floats luminance, floats total) {
    const float count = PATCH * PATCH;
    const floats least = count * DARKEST, share = (count * luminance - total) / (total > least ? total : least);
    const floats below = share < 1.0f ? share : (floats)1.0f;
    return below > -1.0f ? below : (floats)-1.0f;
}
#endif

#ifdef COARSE_CHROMA
#define COARSE_PARAMETERS , __global const float *restrict first_means, __global const float *restrict last_means, \
    __global const float *restrict scale
#define COARSE_READ , first_means, last_means, scale

#define LOW(i) (NEAREST(i) + 1)
#define HIGH(i) (NEAREST(i) + 2)
#define EACH_MEAN(v, far) ((far) ? __builtin_shufflevector(v, v, ALL_LANES(HIGH)) : __builtin_shufflevector(v, v, ALL_LANES(LOW)))

// For LANES pixels from column x of the tile, and column `column` of row `row` of the planes, with the sums of their windows.
INLINE void coarse_change(Ratios *to, int x, const floats total[SOURCES], int row, int column, int rows, int columns
                          COARSE_PARAMETERS) {
    const int stride = MEANS_STRIDE(columns);
    const size_t plane = MEANS_PLANE(rows, columns), at = (size_t)(NEAREST(row) + MARGIN) * stride + MARGIN + column / BIN - 1;
    const floats across = (floats)(ALL_LANES(NEXT_SHARE));
    const ints near = LOAD_PRIVATE(ints, to->near + x + RADIUS - 1) + 2 * LOAD_PRIVATE(ints, to->near + x + RADIUS)
                    + LOAD_PRIVATE(ints, to->near + x + RADIUS + 1);
    floats own[3], inverse[3], change[2] = {0.0f, 0.0f}, weights = COARSE_CHROMA;
    #pragma unroll
    for (int s = 0; s < 3; s++) own[s] = total[s] * (1.0f / (PATCH * PATCH));
    own[LUMINANCE] = CONVERT(near, floats) * 0.0625f;
    inverse_scales(inverse, scale, own[LUMINANCE]);
    #pragma unroll
    for (int j = 0; j < 2; j++) {
        floats first[3], last[2];
        #pragma unroll
        for (int s = 0; s < 3; s++) first[s] = LOAD_GLOBAL(floats, first_means + s * plane + at + j * stride);
        #pragma unroll
        for (int s = 0; s < 2; s++) last[s] = LOAD_GLOBAL(floats, last_means + 2 * s * plane + at + j * stride);
        const float down = j ? NEXT_SHARE(row) : 1.0f - NEXT_SHARE(row);
        #pragma unroll
        for (int i = 0; i < 2; i++) {
            floats difference[3];
            #pragma unroll
            for (int s = 0; s < 3; s++) difference[s] = EACH_MEAN(first[s], i) - own[s];
            const floats weight = likeness(difference, inverse) * ((i ? across : 1.0f - across) * down);
            weights += weight;
            #pragma unroll
            for (int s = 0; s < 2; s++) change[s] += weight * (EACH_MEAN(last[s], i) - own[2 * s]);
        }
    }
    const floats share = 1.0f / weights;
    #pragma unroll
    for (int s = 0; s < 2; s++) STORE_PRIVATE(floats, to->chroma[RATIO_TAPS - 2 + s] + x) = change[s] * share;
}
#else
#define COARSE_PARAMETERS
#define COARSE_READ
#endif

// Of the row whose window begins in padded row `rows[0]`; the tile's first column is x0.
INLINE void taps_behind(Ratios *to, __global const int *planes, __global const int *rows, __global const int *column_source, int x0,
                        int width, int columns, size_t stride COARSE_PARAMETERS) {
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
#ifdef COARSE_CHROMA
        if (s == LUMINANCE) {
            __global const int *above = plane + (size_t)rows[RADIUS - 1] * columns, *below = plane + (size_t)rows[RADIUS + 1] * columns;
            __global const int *middle = plane + (size_t)rows[RADIUS] * columns;
            for (p = first; p + LANES <= last; p += LANES)
                STORE_PRIVATE(ints, to->near + p) =
                    LOAD_GLOBAL(ints, above + p) + 2 * LOAD_GLOBAL(ints, middle + p) + LOAD_GLOBAL(ints, below + p);
            AT_EDGE
            for (; p < last; p++) to->near[p] = above[p] + 2 * middle[p] + below[p];
            AT_EDGE
            for (int i = 0; i < first; i++) to->near[i] = to->near[column_source[x0 + i] - x0 + RADIUS];
            AT_EDGE
            for (int i = p; i < end; i++) to->near[i] = to->near[column_source[x0 + i] - x0 + RADIUS];
        }
#endif
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
#ifdef SHADED_CHROMA
        const floats share = ratio_of(LOAD_PRIVATE(floats, to->luminance + x), total[LUMINANCE]) * (1.0f / (PATCH * PATCH));
        STORE_PRIVATE(floats, to->chroma[0] + x) = total[0] * share;
        STORE_PRIVATE(floats, to->chroma[1] + x) = total[SOURCES - 1] * share;
#endif
#ifdef COARSE_CHROMA
        coarse_change(to, x, total, rows[RADIUS], x0 + x, stride / columns, columns COARSE_READ);
#endif
    }
}

#define BEHIND(ratios) (ratios).chroma[0]
#else
#define BEHIND(ratios) 0
#define COARSE_PARAMETERS
#define COARSE_READ
#endif
