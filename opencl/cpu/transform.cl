// Processor variant: applies the transform of each pixel's class to its patch, and writes the outputs of a layer.
//
// Each work-item processes one tile of TILE columns and BAND rows, row by row. A layer reads SOURCES planes: the mosaic, or the planes from the
// previous layer.
//
// The latest rows are stored in a column-major ring, so that a patch fills as few vectors as possible, instead of one short vector per row. For
// each padded column, the ring contains the latest PATCH rows consecutively. The value at padded row k, column p and source s is
// ring[p * COLUMN + k * SOURCES + s], so a patch consists of PATCH * COLUMN consecutive values. In the next row, every patch begins SOURCES
// values later. The new value of column p then overwrites the oldest value of column p + 1, which is no longer needed. Values are stored once
// and never moved.

#define RING (SPAN * COLUMN + (BAND + 2 * RADIUS) * SOURCES + READ_AHEAD)

#if SOURCES == 1
#define SOURCE ushort

// Stores the newest row in the ring. `to` is the slot of column 0. Floating-point layers subtract the black level here. Fixed-point layers
// include the black level in their intercepts.
INLINE void row_into_ring(tap *to, const ushort *row, float black_level, int span) {
    tap signal[SPAN];
    for (int p = 0; p < span; p += LANES)
#ifdef FIXED_POINT
        STORE_PRIVATE(shorts, signal + p) = LOAD_PRIVATE(shorts, row + p) - (ushort)RAW_MIDDLE;
#else
        STORE_PRIVATE(floats, signal + p) = CONVERT(CONVERT(LOAD_PRIVATE(shorts, row + p), ints), floats) - black_level;
#endif
    #pragma clang loop vectorize(disable) unroll_count(8)
    for (int p = 0; p < span; p++) to[p * COLUMN] = signal[p];
}

typedef struct {
    ushort of[SPAN];
} Row;

INLINE void into_ring(tap *to, __global const ushort *raw, __global const int *column_source, float black_level, int x0, int columns,
                      size_t stride, Row *row, int span) {
    ingest(row->of, raw, column_source, x0, columns);
    row_into_ring(to, row->of, black_level, span);
}
#else
#define SOURCE int

// Converts LANES values of a plane to the type that the layer reads.
#ifdef FIXED_POINT
INLINE signed_shorts signal_of(ints plane) { return CONVERT(coarse(plane), signed_shorts); }
#else
INLINE floats signal_of(ints plane) { return CONVERT(plane, floats); }
#endif
VECTOR(tap, signals, LANES);

// Stores the newest row of every plane in the ring.
INLINE void into_ring(tap *to, __global const int *planes, __global const int *column_source, float black_level, int x0,
                      int columns, size_t stride, Row *row, int span) {
    const int first = max(0, RADIUS - x0), last = min(TILE + 2 * RADIUS, columns - x0 + RADIUS);
    const int end = min(TILE + 2 * RADIUS, columns - x0 + 2 * RADIUS);
    for (int s = 0; s < SOURCES; s++, planes += stride) {
        tap *signal = row->of[s];
        int p = first;
        for (; p + LANES <= last; p += LANES)
            STORE_PRIVATE(signals, signal + p) = signal_of(LOAD_GLOBAL(ints, planes + x0 - RADIUS + p));
        if (last - first >= LANES) {  // the last vector overlaps the previous one
            p = last;
            STORE_PRIVATE(signals, signal + p - LANES) = signal_of(LOAD_GLOBAL(ints, planes + x0 - RADIUS + p - LANES));
        }
        AT_EDGE
        for (int i = 0; i < first; i++) signal[i] = signal_of((ints)planes[column_source[x0 + i]])[0];
        AT_EDGE
        for (; p < end; p++) signal[p] = signal_of((ints)planes[column_source[x0 + p]])[0];
    }
    #pragma clang loop vectorize(disable) unroll_count(4)
    for (int p = 0; p < end; p++)
        for (int s = 0; s < SOURCES; s++) to[p * COLUMN + s] = row->of[s][p];
}
#endif

#ifdef COARSE_CHROMA
#define COARSE_PARAMETERS , __global const float *restrict before, __global const float *restrict after  // blocks before and after smoothing
#define COARSE_READ , before, after

#define LOW(i) (((i) + 2) / 4)
#define HIGH(i) (((i) + 2) / 4 + 1)

// Interpolates the change of plane s by the coarse chroma filter, for `width` pixels in a row from x0 (l3cli/classes/coarse_chroma.py).
INLINE void coarse_row(float *to, int s, int row, int x0, int width, int rows, int columns COARSE_PARAMETERS) {
    const size_t stride = BLOCKS_STRIDE(columns);
    const size_t at = s * BLOCKS_PLANE(rows, columns) + (NEAREST(row) + MARGIN) * stride + MARGIN + x0 / 4 - 1;
    const float down = PLANE_STEP * NEXT_SHARE(row);
    const floats across = (floats)(ALL_LANES(NEXT_SHARE));
    float between[TILE / 4 + 2 + 2 * LANES];
    for (int b = 0; b < width / 4 + 3; b += LANES)
        STORE_PRIVATE(floats, between + b) =
            (LOAD_GLOBAL(floats, after + at + b) - LOAD_GLOBAL(floats, before + at + b)) * (PLANE_STEP - down)
            + (LOAD_GLOBAL(floats, after + at + stride + b) - LOAD_GLOBAL(floats, before + at + stride + b)) * down;
    for (int x = 0; x < width; x += LANES) {
        const floats blocks = LOAD_PRIVATE(floats, between + x / 4);
        const floats low = __builtin_shufflevector(blocks, blocks, ALL_LANES(LOW));
        STORE_PRIVATE(floats, to + x) = low + (__builtin_shufflevector(blocks, blocks, ALL_LANES(HIGH)) - low) * across;
    }
}
#else
#define COARSE_PARAMETERS
#define COARSE_READ
#endif

#ifdef CLIPPING
#define CLIPPING_PARAMETER , __global const float *restrict maps  // maps for each quad, followed by one flag per quad (common/quads.cl)
#define CLIPPING_READ , maps

#define OF_QUAD(i) ((i) / 2)

INLINE floats of_quads(__global const float *map) {
    const floats quads = LOAD_GLOBAL(floats, map);
    return __builtin_shufflevector(quads, quads, ALL_LANES(OF_QUAD));
}

// Replaces the outputs of LANES pixels in uniform clipped areas, then changes the hue in all clipped areas (l3cli/classes/clipping.py).
INLINE void replace_clipped(floats *made, int row, int x, int rows, int columns CLIPPING_PARAMETER) {
    if (!QUAD_FLAGS(maps, rows, columns)[QUAD_GROUP(row / 2, x / 2, columns)]) return;
    __global const float *map = QUAD_MAPS(maps, row / 2, x / 2, columns);
    const floats left = 1.0f - of_quads(map);
    #pragma unroll
    for (int o = 0; o < 3; o++) made[o] = left * made[o] + of_quads(map + OF_MAP(1 + o));
    const floats kept = 1.0f - of_quads(map + OF_MAP(4));
    made[0] = kept * made[0] + of_quads(map + OF_MAP(5)) * made[1];
    made[2] = kept * made[2] + of_quads(map + OF_MAP(6)) * made[1];
}
#else
#define CLIPPING_PARAMETER
#define CLIPPING_READ
#endif

#ifdef CORRECTS
#define CORRECTED_PARAMETER , __global const float *restrict corrected  // (output, row, col) outputs of the first layer
#define CORRECTED_READ , corrected
#else
#define CORRECTED_PARAMETER
#define CORRECTED_READ
#endif

#if !defined(JOINED) && !defined(CLASSES_ONLY)
#define TRANSFORM_PARAMETERS \
    __global const SOURCE *restrict source,      /* (source, row, col) the mosaic in DN, or planes */ \
    __global const int *restrict row_source,     /* (padded row) */ \
    __global const int *restrict column_source,  /* (padded col) */ \
    __global const uint *restrict labels,        /* (row, col) */ \
    __global const tap *restrict weights,        /* (class, …) per unit of the source, packed by layout.py */ \
    __global const float *restrict matrix,       /* (3, 3) from XYZ to linear picture values, then the XYZ of the clipped white */ \
    __global CODE *restrict picture GAIN_PARAMETER COARSE_PARAMETERS CLIPPING_PARAMETER CORRECTED_PARAMETER, \
    float black_level, int source_rows, int rows, int columns

COMPILED_ONCE transform_tile(int x0, int y0, TRANSFORM_PARAMETERS) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int span = WHOLE(WHOLE(width, LANES) + 2 * RADIUS, 16);
    const size_t stride = (size_t)source_rows * columns;
    Row row[ROWS_KEPT] = {0};
    uint label[TILE];
    tap ring[RING];
#ifdef RATIO_TAPS
    float behind[RATIO_TAPS][SPAN];
#endif
    for (int i = 0; i < TILE; i++) label[i] = 0;
    for (int i = 0; i < RING; i++) ring[i] = 0;
    for (int k = 0; k < y1 - y0 + 2 * RADIUS; k++) {
        into_ring(ring + k * SOURCES, source + (size_t)row_source[y0 + k] * columns, column_source, black_level, x0, columns,
                  stride, row + k % ROWS_KEPT, span);
        if (k < 2 * RADIUS) continue;
        const int y = y0 + k - 2 * RADIUS;
        const size_t at = (size_t)y * columns + x0;
        for (int x = 0; x < width; x++) label[x] = labels[at + x];
#ifdef RATIO_TAPS
        taps_behind(behind, row, k + 1, width);
#endif
#ifdef COARSE_CHROMA
        float change[2][SPAN];
        for (int c = 0; c < 2; c++) coarse_row(change[c], 2 * c, row_source[y + RADIUS], x0, width, source_rows, columns COARSE_READ);
#endif
        __global const SOURCE *next = source + (size_t)row_source[min(y0 + k + 1, y1 + 2 * RADIUS - 1)] * columns + x0;
        for (int x = 0; x < width; x += LANES) {
            for (int s = 0; s < SOURCES; s++) FETCH(next + s * stride + x);
            FETCH(labels + at + columns + x);
            totals made[PLANES_MADE];
            apply(made, ring + (k - 2 * RADIUS) * SOURCES, BEHIND, label, weights, x);
#ifdef COARSE_CHROMA
            made[CHROMA_1] += LOAD_PRIVATE(floats, change[0] + x);
            made[CHROMA_2] += LOAD_PRIVATE(floats, change[1] + x);
#endif
#ifdef CLIPPING
            replace_clipped(made, row_source[y + RADIUS], x0 + x, source_rows, columns CLIPPING_READ);
#endif
#ifdef CORRECTS
            __global const float *first = corrected + (size_t)row_source[y + RADIUS] * columns + x0 + x;
            for (int o = 0; o < OUTPUTS; o++) made[o] += LOAD_GLOBAL(floats, first + o * stride);
#endif
            limit_to_white(made, matrix);
#ifdef SHADED
            even_pixels(made, gain + (size_t)y * GAIN_NODES(columns), x0 + x);
#endif
            write_pixels(picture, made, matrix, at + x, width - x, (size_t)rows * columns);
        }
    }
}

KERNEL_OF_ONE transform(TRANSFORM_PARAMETERS) {
    transform_tile(GROUP_COLUMN, GROUP_ROW, source, row_source, column_source, labels, weights, matrix, picture GAIN_READ COARSE_READ
                   CLIPPING_READ CORRECTED_READ, black_level,
                   source_rows, rows, columns);
}
#endif
