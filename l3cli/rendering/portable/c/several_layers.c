/* ----------------------------------------------------------------------------------------------------------------- render */

typedef struct {
    Statistics statistics;
    Gradients gradients;
    size_t ring_values;
    int16_t *fixed_ring;
    float *ring;
    int32_t *planes[2]; /* (plane, row, column) that a layer reads, and that it makes */
} Workspace;

static Workspace workspace_in(Room *room, int rows, int columns) {
    const uint64_t most = (uint64_t)(columns + L3_MOST_SIDE) * L3_MOST_COLUMN + 3 * (uint64_t)(rows + L3_MOST_SIDE) + L3_MOST_TAPS;
    const uint64_t pixels = (uint64_t)rows * (uint64_t)columns;
    Workspace w;
    w.statistics = statistics_in(room, rows, columns);
    w.gradients = gradients_in(room, columns);
    w.ring_values = (size_t)most;
    w.fixed_ring = take(room, most, sizeof *w.fixed_ring);
    w.ring = take(room, most, sizeof *w.ring);
    for (int i = 0; i < 2; i++) w.planes[i] = take(room, i < L3_LAYERS - 1 ? 3 * pixels : 0, sizeof *w.planes[i]);
    return w;
}

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
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns;
    pad_mosaic(raw, rows, columns, padded_span(columns), w.statistics.padded);
    label_mosaic(&w.statistics, rows, columns, phase_row, phase_column, labels);
    mosaic_to_planes(w.statistics.padded, w.fixed_ring, w.ring_values, rows, columns, labels, w.planes[0]);
    for (int i = 0; i < L3_LAYERS - 1; i++) {
        const L3PlaneLayer *layer = l3_layers + i;
        const int32_t *planes = w.planes[i % 2];
        uint32_t *own = labels + (i + 1) * pixels;
        if (layer->tree) label_by_tree(&w.gradients, layer, planes, labels, rows, columns, phase_row, phase_column, own);
        else label_by_structure(&w.gradients, layer, planes, labels, rows, columns, phase_row, phase_column, own);
        if (layer->weights) planes_to_outputs(layer, planes, w.ring, w.ring_values, rows, columns, own, outputs);
        else planes_to_planes(layer, planes, w.fixed_ring, w.ring_values, rows, columns, own, w.planes[(i + 1) % 2]);
    }
    return 0;
}
