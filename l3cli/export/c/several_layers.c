/* ----------------------------------------------------------------------------------------------------------------- layers */

typedef struct {
    Statistics statistics;
    Gradients gradients;
    size_t ring_values;
    int16_t *fixed_ring; /* ring buffer of all layers except the last */
    Ring ring;           /* ring buffer of the last layer */
    int32_t *planes[2];  /* (plane, row, column) planes that a layer reads, and planes that the layer writes; exchanged after each layer */
    int32_t *sums;       /* (plane, padded column) sums over the rows of the window in the last layer */
    CoarseChroma coarse;
    Clipping clipping;
} Workspace;

static Workspace workspace_in(Room *room, int rows, int columns) {
    const uint64_t most = (uint64_t)(columns + L3_MOST_SIDE) * L3_MOST_COLUMN + 3 * (uint64_t)(rows + L3_MOST_SIDE) + L3_MOST_TAPS;
    const uint64_t pixels = (uint64_t)rows * (uint64_t)columns;
    Workspace w;
    w.statistics = statistics_in(room, rows, columns);
    w.gradients = gradients_in(room, columns);
    w.ring_values = (size_t)most;
    w.fixed_ring = take(room, most, sizeof *w.fixed_ring);
    w.ring = ring_in(room, most);
    for (int i = 0; i < 2; i++) w.planes[i] = take(room, i < L3_LAYERS - 1 ? 3 * pixels : 0, sizeof *w.planes[i]);
    w.sums = take(room, L3_RATIO_TAPS ? 3 * (uint64_t)(columns + L3_MOST_SIDE) : 0, sizeof *w.sums);
    w.coarse = coarse_in(room, rows, columns);
    w.clipping = clipping_in(room, rows, columns);
    return w;
}

/* Computes the classes and planes of one layer after the other from the padded mosaic, and finally the outputs. */
static void render_layers(const Workspace *w, int rows, int columns, int phase_row, int phase_column, uint32_t *labels,
                          L3Output *outputs) {
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns;
    label_mosaic(&w->statistics, rows, columns, phase_row, phase_column, labels);
    mosaic_to_planes(w->statistics.padded, w->fixed_ring, w->ring_values, rows, columns, labels, w->planes[0]);
    for (int i = 0; i < L3_LAYERS - 1; i++) {
        const L3PlaneLayer *layer = l3_layers + i;
        const int32_t *planes = w->planes[i % 2];
        uint32_t *own = labels + (i + 1) * pixels;
        if (layer->tree) label_by_tree(&w->gradients, layer, planes, labels, rows, columns, own);
        else label_by_structure(&w->gradients, layer, planes, labels, rows, columns, own);
        if (i == L3_LAYERS - 2) {
            planes_to_outputs(layer, planes, &w->ring, w->ring_values, w->sums, rows, columns, own, outputs);
            add_first_outputs(&w->ring, w->ring_values, w->statistics.padded, rows, columns, labels, outputs);
            add_coarse_chroma(&w->coarse, planes, rows, columns, outputs);
            replace_clipped(&w->clipping, w->statistics.padded, rows, columns, phase_row, phase_column, outputs);
        } else planes_to_planes(layer, planes, w->fixed_ring, w->ring_values, rows, columns, own, w->planes[(i + 1) % 2]);
    }
}

