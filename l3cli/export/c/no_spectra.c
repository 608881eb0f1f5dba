/* This table does not smooth spectra. */
typedef struct {
    int nothing;
} Spectra;

static Spectra spectra_in(Room *room, int columns) {
    const Spectra s = {0};
    (void)room, (void)columns;
    return s;
}

static void smooth_spectra(const Spectra *s, int rows, int columns, const L3Output *outputs) {
    (void)s, (void)rows, (void)columns, (void)outputs;
}

