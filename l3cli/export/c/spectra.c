/* ---------------------------------------------------------------------------------------------------------------- spectra */

#define REACHED (L3_SPECTRAL_WINDOW / 2) /* number of rows (or columns) of the window on each side of a pixel */
#define NEIGHBOURS (L3_SPECTRAL_WINDOW * L3_SPECTRAL_WINDOW)

/* Copies of the latest rows of the outputs, because the smoothed rows overwrite the outputs. Row r is at index r % L3_SPECTRAL_WINDOW. It
 * has REACHED mirrored columns on both sides. */
typedef struct {
    ptrdiff_t span;       /* length of a row with the mirrored columns */
    float *made;          /* (L3_SPECTRAL_WINDOW, output, span) outputs before smoothing */
    float *brightness;    /* (L3_SPECTRAL_WINDOW, span) mean of the outputs */
    float *weight;        /* (NEIGHBOURS, column) weights of the neighbours of each pixel of a row */
    float *share;         /* (column) 1 / sum of the weights */
    float *kept;          /* (column) brightness of the pixel / weighted mean brightness of the neighbours */
} Smoothing;

static Smoothing smoothing_in(Room *room, int columns) {
    const uint64_t span = (uint64_t)columns + 2 * REACHED;
    Smoothing s;
    s.span = (ptrdiff_t)span;
    s.made = take(room, L3_SPECTRAL_WINDOW * L3_OUTPUTS * span, sizeof *s.made);
    s.brightness = take(room, L3_SPECTRAL_WINDOW * span, sizeof *s.brightness);
    s.weight = take(room, NEIGHBOURS * (uint64_t)columns, sizeof *s.weight);
    s.share = take(room, (uint64_t)columns, sizeof *s.share);
    s.kept = take(room, (uint64_t)columns, sizeof *s.kept);
    return s;
}

static float *made_row(const Smoothing *s, int row, int output) {
    return s->made + (row % L3_SPECTRAL_WINDOW * L3_OUTPUTS + output) * s->span;
}

static float *brightness_row(const Smoothing *s, int row) { return s->brightness + row % L3_SPECTRAL_WINDOW * s->span; }

static void keep_row(const Smoothing *s, int row, int rows, int columns, const float *outputs) {
    float *restrict brightness = brightness_row(s, row);
    for (ptrdiff_t p = 0; p < s->span; p++) brightness[p] = 0;
    for (int o = 0; o < L3_OUTPUTS; o++) {
        const float *restrict from = outputs + ((ptrdiff_t)o * rows + row) * columns;
        float *restrict to = made_row(s, row, o);
        for (int i = 0; i < REACHED; i++) {
            to[i] = from[mirrored(i - REACHED, columns, 1)];
            to[columns + REACHED + i] = from[mirrored(columns + i, columns, 1)];
        }
        for (int x = 0; x < columns; x++) to[REACHED + x] = from[x];
        for (ptrdiff_t p = 0; p < s->span; p++) brightness[p] += to[p];
    }
    for (ptrdiff_t p = 0; p < s->span; p++) brightness[p] *= 1.0f / L3_OUTPUTS;
}

static void weigh_neighbours(const Smoothing *s, int row, int rows, int columns) {
    const float *restrict own = brightness_row(s, row) + REACHED;
    float *restrict share = s->share, *restrict kept = s->kept;
    for (int x = 0; x < columns; x++) share[x] = kept[x] = 0;
    for (int n = 0; n < NEIGHBOURS; n++) {
        const int neighbour = mirrored(row + n / L3_SPECTRAL_WINDOW - REACHED, rows, 1);
        const float *restrict there = brightness_row(s, neighbour) + n % L3_SPECTRAL_WINDOW;
        float *restrict weight = s->weight + (ptrdiff_t)n * columns;
        for (int x = 0; x < columns; x++) {
            const float above = own[x] > L3_DARKEST ? own[x] : L3_DARKEST, difference = there[x] - own[x];
            const float part = difference / (L3_SPECTRAL_REACH * above), left = 1 - part * part;
            const float positive = left > 0 ? left : 0;
            weight[x] = positive * positive;
            share[x] += weight[x];
            kept[x] += weight[x] * difference;
        }
    }
    for (int x = 0; x < columns; x++) {
        share[x] = 1 / share[x];
        kept[x] = own[x] > L3_DARKEST ? own[x] / (own[x] + kept[x] * share[x]) : 1;
    }
}

static void smooth_row(const Smoothing *s, int row, int rows, int columns, int output, float *restrict to) {
    const float *restrict own = made_row(s, row, output) + REACHED, *restrict brightness = brightness_row(s, row) + REACHED;
    for (int x = 0; x < columns; x++) to[x] = 0;
    for (int n = 0; n < NEIGHBOURS; n++) {
        const int neighbour = mirrored(row + n / L3_SPECTRAL_WINDOW - REACHED, rows, 1);
        const float *restrict there = made_row(s, neighbour, output) + n % L3_SPECTRAL_WINDOW;
        const float *restrict weight = s->weight + (ptrdiff_t)n * columns;
        for (int x = 0; x < columns; x++) to[x] += weight[x] * (there[x] - own[x]);
    }
    for (int x = 0; x < columns; x++) {
        const float mean = (own[x] + to[x] * s->share[x]) * s->kept[x];
        to[x] = brightness[x] > L3_DARKEST ? mean : own[x];
    }
}

/* Averages the spectrum of each pixel with neighbours of similar brightness, without changing the brightness. */
static void smooth_outputs(const Smoothing *s, const uint16_t *padded, int rows, int columns, int phase_row, int phase_column,
                           float *outputs) {
    (void)padded, (void)phase_row, (void)phase_column;
    for (int row = 0; row < REACHED && row < rows; row++) keep_row(s, row, rows, columns, outputs);
    for (int row = 0; row < rows; row++) {
        if (row + REACHED < rows) keep_row(s, row + REACHED, rows, columns, outputs);
        weigh_neighbours(s, row, rows, columns);
        for (int o = 0; o < L3_OUTPUTS; o++)
            smooth_row(s, row, rows, columns, o, outputs + ((ptrdiff_t)o * rows + row) * columns);
    }
}

