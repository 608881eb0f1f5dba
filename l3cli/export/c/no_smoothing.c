/* This table smooths neither spectra nor chroma. */
typedef struct {
    int nothing;
} Smoothing;

static Smoothing smoothing_in(Room *room, int columns) {
    const Smoothing s = {0};
    (void)room, (void)columns;
    return s;
}

static void smooth_outputs(const Smoothing *s, const uint16_t *padded, int rows, int columns, int phase_row, int phase_column,
                           const L3Output *outputs) {
    (void)s, (void)padded, (void)rows, (void)columns, (void)phase_row, (void)phase_column, (void)outputs;
}

