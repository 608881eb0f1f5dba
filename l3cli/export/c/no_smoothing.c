/* This table smooths neither spectra nor chroma. */
typedef struct {
    int nothing;
} Smoothing;

static Smoothing smoothing_in(Room *room, int columns) {
    const Smoothing s = {0};
    (void)room, (void)columns;
    return s;
}

static void smooth_outputs(const Smoothing *s, int rows, int columns, const L3Output *outputs) {
    (void)s, (void)rows, (void)columns, (void)outputs;
}

