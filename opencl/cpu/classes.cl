// Processor variant: computes the class of every pixel from the raw frame.
//
// Each work-item processes one tile of TILE columns and BAND rows, row by row.

// Parameters of all functions that compute classes. CLASSES_READ contains the corresponding arguments.
#define CLASSES_PARAMETERS \
    __global const ushort *restrict raw,                /* (row, col) DN */ \
    __global const int *restrict row_source,            /* (padded row) */ \
    __global const int *restrict column_source,         /* (padded col) */ \
    __global const ushort *restrict member,             /* (channel, CFA row, period) all bits set if a pixel has the channel */ \
    __global const ushort *restrict channel_bit,        /* (CFA row, period) 1 << channel */ \
    __global const uint *restrict count,                /* (channel, CFA row, period) number of taps of the channel */ \
    __global const uint *restrict mean_reciprocal,      /* (channel, CFA row, period) round(65536 / count) */ \
    __global const uint *restrict variance_reciprocal,  /* (channel, CFA row, period) round(512 / count) */ \
    __global const uint *restrict site_column,          /* (period) CFA column */ \
    RULE_CONSTANTS SET_PARAMETER
#define CLASSES_READ raw, row_source, column_source, member, channel_bit, count, mean_reciprocal, variance_reciprocal, site_column, \
    RULE SET_READ

// Statistics of the latest rows of a tile. The caller declares the arrays separately, so that the compiler knows that they do not overlap.
typedef struct {
    ushort (*ring)[SPAN];  // PATCH + 1 rows; padded row k of the tile is in slot k % (PATCH + 1)
    Columns *window;
    Runs *runs;
#ifdef BOX_ROWS
    box (*boxes)[SPAN];    // sums over boxes; boxes with the last padded row k are in slot k % (PATCH + 1)
#endif
} Seen;

#ifdef BOX_ROWS
#define HAVE_SEEN(name) ushort seen_ring[PATCH + 1][SPAN]; Columns seen_near; Runs seen_runs; box seen_boxes[PATCH + 1][SPAN]; \
    Seen name = {seen_ring, &seen_near, &seen_runs, seen_boxes};
#else
#define HAVE_SEEN(name) ushort seen_ring[PATCH + 1][SPAN]; Columns seen_near; Runs seen_runs; \
    Seen name = {seen_ring, &seen_near, &seen_runs};
#endif

INLINE void see_nothing(Seen *seen) {
    for (int k = 0; k < PATCH + 1; k++)
        for (int p = 0; p < SPAN; p++) seen->ring[k][p] = 0;
    for (int j = 0; j < SPREAD; j++)
        for (int p = 0; p < SPAN; p++) seen->window->saturated[j][p] = 0;
    for (int c = 0; c < CHANNELS; c++) {
        for (int p = 0; p < SPAN; p++) seen->window->sum[c][p] = 0;
        for (int p = 0; p < SPAN; p++) seen->window->square[c][p] = 0;
        for (int p = 0; p < SPAN; p++) seen->runs->sum[c][p] = seen->runs->square[c][p] = 0;
    }
}

// Number of columns that a tile reads, rounded up to whole vectors.
INLINE int span_of(int width) { return WHOLE(WHOLE(width, LANES) + 2 * RADIUS, 2 * LANES); }

// Adds padded row k of the tile at (y0, x0) to the statistics. Only the first `width` columns of the tile lie inside the frame.
INLINE void see_row(Seen *seen, int k, int x0, int y0, int width, int phase_row, int phase_column, int columns, CLASSES_PARAMETERS) {
    const int span = span_of(width), padded_phase = PADDED_PHASE(x0, phase_column, CFA_COLUMNS);
    // The slot after the newest row contains the row that leaves the patch, or zeros before the first patch is complete.
    ushort *entering = seen->ring[k % (PATCH + 1)], *leaving = seen->ring[(k + 1) % (PATCH + 1)];
    ingest(entering, raw + (size_t)row_source[y0 + k] * columns, column_source, x0, columns);
    const int row_phase = PADDED_PHASE(y0 + k, phase_row, CFA_ROWS);
    const int leaving_phase = PADDED_PHASE(y0 + k + (CFA_ROWS - 1) * PATCH, phase_row, CFA_ROWS);
    slide(seen->window, entering, member + row_phase * PERIOD, leaving, member + leaving_phase * PERIOD, padded_phase, span);
#ifdef BOX_ROWS
    add_boxes(seen->boxes[k % (PATCH + 1)], seen->ring, k % (PATCH + 1), span);
#endif
    const int late = k - (RADIUS - SATURATION_RADIUS);  // saturation is tested in fewer rows than the patch has
    if (late >= 0)
        saturated_row(seen->window->saturated[late % SPREAD], seen->ring[late % (PATCH + 1)],
                      channel_bit + PADDED_PHASE(y0 + late, phase_row, CFA_ROWS) * PERIOD, padded_phase, span);
}

// Returns the classes of LANES pixels in a row of the tile from column x. The first of them is pixel `at` of the frame and has the CFA column
// `phase`. The last row of their patches is padded row k.
INLINE uints classes_at(const Seen *seen, int k, int x, size_t at, int site_row, int phase, CLASSES_PARAMETERS) {
    Evidence evidence;
    no_evidence(&evidence, RULE);
    #pragma unroll
    for (int c = 0; c < CHANNELS; c++) {
        const int place = (c * CFA_ROWS + site_row) * PERIOD + phase;
        add_evidence(&evidence, c, LOAD_GLOBAL(uints, count + place), patch_sum(seen->runs, seen->window, c, x),
                     patch_square(seen->runs, seen->window, c, x), LOAD_GLOBAL(uints, mean_reciprocal + place),
                     LOAD_GLOBAL(uints, variance_reciprocal + place), RULE);
    }
#ifdef BOX_ROWS
#define ADD_WINDOW(s, top, left, rows, columns, sign) \
    evidence.window_sum[s] = evidence.window_sum[s] sign LOAD_BOX(seen->boxes[(k - 2 * RADIUS + top + rows - 1) % (PATCH + 1)] + x + left);
    EACH_WINDOW(ADD_WINDOW)
#elif defined(EACH_WINDOW)
#define ADD_WINDOW(s, top, left, rows, columns, sign) \
    evidence.window_sum[s] = evidence.window_sum[s] sign window_sum(seen->ring, k - 2 * RADIUS, top, left, rows, columns, x);
    EACH_WINDOW(ADD_WINDOW)
#endif
    const uints site = LOAD_GLOBAL(uints, site_column + phase) + site_row * CFA_COLUMNS;
    return class_of(&evidence, site, patch_saturated(seen->runs, x), SET_AT(at) RULE);
}

INLINE void write_classes(__global uint *to, uints label, int count) {
    if (count >= LANES) STORE_GLOBAL(uints, to) = label;
    else WRITE_FIRST(uint, uints, to, label, count);
}

#if !defined(TRANSFORM_ONLY) && !defined(JOINED)  // with TRANSFORM_ONLY, another program contains this kernel; with JOINED, joined.cl replaces it
COMPILED_ONCE classes_of_tile(int x0, int y0, CLASSES_PARAMETERS,
                              __global uint *restrict labels,  // (row, col)
                              int phase_row, int phase_column, int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int first_phase = (x0 + phase_column) % CFA_COLUMNS;
    HAVE_SEEN(seen)
    see_nothing(&seen);
    for (int k = 0; k < y1 - y0 + 2 * RADIUS; k++) {
        see_row(&seen, k, x0, y0, width, phase_row, phase_column, columns, CLASSES_READ);
        if (k < 2 * RADIUS) continue;
        const int y = y0 + k - 2 * RADIUS, site_row = (y + phase_row) % CFA_ROWS;
        add_runs(seen.runs, seen.window, span_of(width));
        const size_t at = (size_t)y * columns + x0;
        __global const ushort *next = raw + (size_t)row_source[min(y0 + k + 1, y1 + 2 * RADIUS - 1)] * columns + x0;
        for (int x = 0, phase = first_phase; x < width; x += LANES, phase = PHASE_AFTER(phase, LANES)) {
            FETCH(next + x);
            write_classes(labels + at + x, classes_at(&seen, k, x, at + x, site_row, phase, CLASSES_READ), width - x);
        }
    }
}

KERNEL_OF_ONE classes(CLASSES_PARAMETERS, __global uint *restrict labels, int phase_row, int phase_column, int rows, int columns) {
    classes_of_tile(GROUP_COLUMN, GROUP_ROW, CLASSES_READ, labels, phase_row, phase_column, rows, columns);
}
#endif
