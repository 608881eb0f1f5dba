/* ------------------------------------------------------------------------------------------------------------- transforms */

/* Patches are dot products of L3_TAPS values one behind the other. So the latest rows lie in a ring column by column: padded column
 * p's padded row k lies at ring[p * L3_PATCH + k], and the patch of column x of row y begins at ring[x * L3_PATCH + y]. One row on,
 * every patch moves by one value, and the new pixel of column p falls where column p + 1 kept the row that is needed no more. */
typedef struct {
    Statistics statistics;
    float *ring;
} Workspace;

static uint64_t ring_values(int rows, int columns) {
    return (uint64_t)(columns + DIAMETER) * L3_PATCH + (uint64_t)(rows + DIAMETER) + L3_TAPS;
}

static Workspace workspace_in(Room *room, int rows, int columns) {
    Workspace w;
    w.statistics = statistics_in(room, rows, columns);
    w.ring = take(room, ring_values(rows, columns), sizeof *w.ring);
    return w;
}

/* Sum of products, in sixteen parts that do not wait for one another. */
static float dot(const float *restrict a, const float *restrict b) {
    float part[16] = {0}, eight[8], four[4];
    for (int t = 0; t < L3_TAPS; t += 16)
        for (int i = 0; i < 16; i++) part[i] += a[t + i] * b[t + i];
    for (int i = 0; i < 8; i++) eight[i] = part[i] + part[i + 8];
    for (int i = 0; i < 4; i++) four[i] = eight[i] + eight[i + 4];
    return (four[0] + four[2]) + (four[1] + four[3]);
}

static void transform(const Statistics *s, float *restrict ring, int rows, int columns, const uint32_t *restrict labels,
                      float *restrict outputs) {
    const ptrdiff_t span = padded_span(columns), pixels = (ptrdiff_t)rows * columns;
    for (uint64_t i = 0; i < ring_values(rows, columns); i++) ring[i] = 0;
    for (int k = 0; k < rows + DIAMETER; k++) {
        const uint16_t *restrict row = s->padded + k * span;
        for (int p = 0; p < columns + DIAMETER; p++) ring[(ptrdiff_t)p * L3_PATCH + k] = (float)row[p] - L3_BLACK_LEVEL;
        if (k < DIAMETER) continue;
        const ptrdiff_t at = (ptrdiff_t)(k - DIAMETER) * columns;
        for (int x = 0; x < columns; x++) {
            const float *patch = ring + (ptrdiff_t)x * L3_PATCH + k - DIAMETER;
            const uint32_t label = labels[at + x];
            for (int o = 0; o < L3_OUTPUTS; o++)
                outputs[o * pixels + at + x] = dot(patch, l3_weights[label][o]) + l3_intercept[label][o];
        }
    }
}

/* ----------------------------------------------------------------------------------------------------------------- render */

size_t l3_workspace_bytes(int rows, int columns) {
    if (rows < 1 || columns < 1 || rows > L3_MOST_PIXELS || columns > L3_MOST_PIXELS) return 0;
    Room room = {NULL, 0};
    (void)workspace_in(&room, rows, columns);
    return room.used <= SIZE_MAX / 2 ? (size_t)room.used : 0;
}

int l3_render(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, void *workspace, uint32_t *labels,
              float *outputs) {
    if (l3_workspace_bytes(rows, columns) == 0) return -1;
    if (phase_row < 0 || phase_row >= L3_CFA_ROWS || phase_column < 0 || phase_column >= L3_CFA_COLUMNS) return -1;
    Room room = {workspace, 0};
    const Workspace w = workspace_in(&room, rows, columns);
    pad_mosaic(raw, rows, columns, padded_span(columns), w.statistics.padded);
    label_mosaic(&w.statistics, rows, columns, phase_row, phase_column, labels);
    transform(&w.statistics, w.ring, rows, columns, labels, outputs);
    return 0;
}
