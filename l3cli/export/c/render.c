/* ------------------------------------------------------------------------------------------------------------ clipped white */

/* Limits the luminance to the darkest white that clips every channel. The colour of brighter pixels fades to this white. */
static void limit_to_white(ptrdiff_t pixels, L3Output *outputs) {
#ifdef L3_WHITE_SLOPE
    static const L3Output white[3] = {L3_WHITE_X, L3_WHITE_Y, L3_WHITE_Z};
    for (ptrdiff_t i = 0; i < pixels; i++)
        if (outputs[pixels + i] > white[1]) fade_to_white(outputs + i, pixels, white);
#else
    (void)pixels, (void)outputs;
#endif
}

/* ----------------------------------------------------------------------------------------------------------------- render */

size_t l3_workspace_bytes(int rows, int columns) {
    if (rows < 1 || columns < 1 || rows > L3_MOST_PIXELS || columns > L3_MOST_PIXELS) return 0;
    Room room = {NULL, 0};
    (void)workspace_in(&room, rows, columns);
    (void)smoothing_in(&room, columns);
    return room.used <= SIZE_MAX / 2 ? (size_t)room.used : 0;
}

int l3_render(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, void *workspace, uint32_t *labels,
              L3Output *outputs) {
    if (l3_workspace_bytes(rows, columns) == 0) return -1;
    if (phase_row < 0 || phase_row >= L3_CFA_ROWS || phase_column < 0 || phase_column >= L3_CFA_COLUMNS) return -1;
    Room room = {workspace, 0};
    const Workspace w = workspace_in(&room, rows, columns);
    const Smoothing smoothing = smoothing_in(&room, columns);
    pad_mosaic(raw, rows, columns, padded_span(columns), w.statistics.padded);
    render_layers(&w, rows, columns, phase_row, phase_column, labels, outputs);
    limit_to_white((ptrdiff_t)rows * columns, outputs);
    smooth_outputs(&smoothing, w.statistics.padded, rows, columns, phase_row, phase_column, outputs);
    return 0;
}
