/* ------------------------------------------------------------------------------------------------------------- transforms */

/* A transform is a dot product of L3_LAST_TAPS consecutive values. The latest rows are therefore stored column by column: the value of
 * padded row k and padded column p is ring[p * L3_PATCH + k], and the patch of row y and column x begins at ring[x * L3_PATCH + y]. In
 * the next row, every patch begins one value later. The new value of column p overwrites the oldest value of column p + 1, which is
 * no longer needed. */
typedef struct {
    Statistics statistics;
    Ring ring;
    uint64_t ring_values;
} Workspace;

static Workspace workspace_in(Room *room, int rows, int columns) {
    Workspace w;
    w.statistics = statistics_in(room, rows, columns);
    w.ring_values = (uint64_t)(columns + DIAMETER) * L3_PATCH + (uint64_t)(rows + DIAMETER) + L3_LAST_TAPS;
    w.ring = ring_in(room, w.ring_values);
    return w;
}

/* Computes classes and outputs from the padded mosaic. */
static void render_layers(const Workspace *w, int rows, int columns, int phase_row, int phase_column, uint32_t *restrict labels,
                          L3Output *restrict outputs) {
    const ptrdiff_t span = padded_span(columns), pixels = (ptrdiff_t)rows * columns;
    label_mosaic(&w->statistics, rows, columns, phase_row, phase_column, labels);
    for (size_t i = 0; i < w->ring_values; i++) keep_nothing(&w->ring, i);
    for (int k = 0; k < rows + DIAMETER; k++) {
        const uint16_t *restrict row = w->statistics.padded + k * span;
        for (int p = 0; p < columns + DIAMETER; p++) keep(&w->ring, (size_t)p * L3_PATCH + (size_t)k, row[p]);
        if (k < DIAMETER) continue;
        const ptrdiff_t at = (ptrdiff_t)(k - DIAMETER) * columns;
        for (int x = 0; x < columns; x++)
            for (size_t o = 0; o < L3_OUTPUTS; o++)
                outputs[(ptrdiff_t)o * pixels + at + x] =
                    output_of(&w->ring, (ptrdiff_t)x * L3_PATCH + k - DIAMETER, (size_t)labels[at + x] * L3_OUTPUTS + o, 0);
    }
}

