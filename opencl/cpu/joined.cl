// Processor variant: computes classes and outputs of the first layer in one kernel. The classes of a row are used while they are in the first-level
// cache, and raw values are read only once. Classes are written only if another layer reads them.

#ifdef JOINED
#define JOINED_PARAMETERS \
    CLASSES_PARAMETERS, \
    __global uint *restrict labels,        /* (row, col) */ \
    __global const tap *restrict weights,  /* from here on as in transform.cl */ \
    __global const float *restrict matrix, \
    __global CODE *restrict picture GAIN_PARAMETER, \
    float black_level, int phase_row, int phase_column, int rows, int columns

COMPILED_ONCE classes_and_transform_of_tile(int x0, int y0, JOINED_PARAMETERS) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int first_phase = (x0 + phase_column) % CFA_COLUMNS;
    HAVE_SEEN(seen)
    uint label[TILE + LANES];
    tap ring[RING];
    see_nothing(&seen);
    for (int i = 0; i < TILE + LANES; i++) label[i] = 0;
    for (int i = 0; i < RING; i++) ring[i] = 0;
    for (int k = 0; k < y1 - y0 + 2 * RADIUS; k++) {
        see_row(&seen, k, x0, y0, width, phase_row, phase_column, columns, CLASSES_READ);
        row_into_ring(ring + k, seen.ring[k % (PATCH + 1)], black_level, span_of(width));
        if (k < 2 * RADIUS) continue;
        const int y = y0 + k - 2 * RADIUS, site_row = (y + phase_row) % CFA_ROWS;
        const size_t at = (size_t)y * columns + x0;
        add_runs(seen.runs, seen.window, span_of(width));
        __global const ushort *next = raw + (size_t)row_source[min(y0 + k + 1, y1 + 2 * RADIUS - 1)] * columns + x0;
        for (int x = 0, phase = first_phase; x < width; x += LANES, phase = PHASE_AFTER(phase, LANES)) {
            FETCH(next + x);
            const uints classes = classes_at(&seen, k, x, at + x, site_row, phase, CLASSES_READ);
            STORE_PRIVATE(uints, label + x) = classes;
#ifdef FIXED_POINT
            write_classes(labels + at + x, classes, width - x);
#endif
        }
        for (int x = 0; x < width; x += LANES) {
            totals made[PLANES_MADE];
            apply(made, ring + k - 2 * RADIUS, 0, label, weights, x);
            limit_to_white(made, matrix);
#ifdef SHADED
            even_pixels(made, gain + (size_t)y * GAIN_NODES(columns), x0 + x);
#endif
            write_pixels(picture, made, matrix, at + x, width - x, (size_t)rows * columns);
        }
    }
}

KERNEL_OF_ONE classes_and_transform(JOINED_PARAMETERS) {
    classes_and_transform_of_tile(GROUP_COLUMN, GROUP_ROW, CLASSES_READ, labels, weights, matrix, picture GAIN_READ, black_level,
                                  phase_row, phase_column, rows, columns);
}
#endif
