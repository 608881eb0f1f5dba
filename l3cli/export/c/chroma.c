/* --------------------------------------------------------------------------------------------------------- smoothed chroma */

#define REACHED L3_CHROMA_REACH /* distance of the farthest neighbours in pixels */
#define HELD (2 * REACHED + 1)

/* Copies of the latest rows of X, Y and Z, because the smoothed rows overwrite the outputs. Row r is at index r % HELD. It has REACHED
 * mirrored columns on both sides. */
typedef struct {
    ptrdiff_t span; /* length of a row with the mirrored columns */
    L3Output *made; /* (HELD, 3, span) outputs before smoothing */
} Smoothing;

static Smoothing smoothing_in(Room *room, int columns) {
    const uint64_t span = (uint64_t)columns + 2 * REACHED;
    Smoothing s;
    s.span = (ptrdiff_t)span;
    s.made = take(room, HELD * 3 * span, sizeof *s.made);
    return s;
}

static L3Output *made_row(const Smoothing *s, int row) { return s->made + row % HELD * 3 * s->span; }

static void keep_row(const Smoothing *s, int row, int rows, int columns, const L3Output *outputs) {
    for (int o = 0; o < 3; o++) {
        const L3Output *restrict from = outputs + ((ptrdiff_t)o * rows + row) * columns;
        L3Output *restrict to = made_row(s, row) + o * s->span;
        for (int i = 0; i < REACHED; i++) {
            to[i] = from[mirrored(i - REACHED, columns, 1)];
            to[columns + REACHED + i] = from[mirrored(columns + i, columns, 1)];
        }
        for (int x = 0; x < columns; x++) to[REACHED + x] = from[x];
    }
}

/* Writes X and Z of a row. `stride` is the distance between X, Y and Z in memory. */
static void smooth_row(const Smoothing *s, int row, int rows, int columns, ptrdiff_t stride, L3Output *to) {
    static const int down[] = {L3_CHROMA_ROWS}, right[] = {L3_CHROMA_COLUMNS};
    const ptrdiff_t span = s->span;
    const L3Output *own = made_row(s, row) + REACHED, *there[L3_NEIGHBOURS];
    for (int n = 0; n < L3_NEIGHBOURS; n++) there[n] = made_row(s, mirrored(row + down[n], rows, 1)) + REACHED + right[n];
    for (int x = 0; x < columns; x++) {
        const float own_x = (float)own[x], luminance = (float)own[span + x], own_z = (float)own[2 * span + x];
        if (luminance <= L3_DARKEST) continue;
        float differences = 0;
        for (int n = 0; n < L3_NEAR_NEIGHBOURS; n++) {
            const float its = (float)there[n][span + x];
            differences += luminance > its ? luminance - its : its - luminance;
        }
        const float contrast = differences / L3_NEAR_NEIGHBOURS, most = L3_MAX_CONTRAST * luminance;
        const float inverse = 1 / (luminance + (contrast < most ? contrast : most)), square = inverse * inverse;
        const float by_black = 1 / (luminance * luminance), fourth = square * by_black;
        const float by_brighter = L3_BY_LUMINANCE * square, by_darker = by_brighter > by_black ? by_brighter : by_black;
        const float by_x = L3_BY_X * fourth, by_z = L3_BY_Z * fourth;
        float divisor = luminance, change_x = 0, change_z = 0;
        for (int n = 0; n < L3_NEIGHBOURS; n++) {
            const float its = (float)there[n][span + x], brighter = its - luminance;
            const float unlike_x = (float)there[n][x] * luminance - own_x * its;
            const float unlike_z = (float)there[n][2 * span + x] * luminance - own_z * its;
            const float unlike = unlike_x * unlike_x * by_x + unlike_z * unlike_z * by_z;
            const float by_luminance = brighter > 0 ? by_brighter : by_darker;
            const float left = 1 - brighter * brighter * by_luminance - (n < L3_NEAR_NEIGHBOURS ? 1.0f : L3_FAR_UNLIKE) * unlike;
            const float positive = left > 0 ? left : 0, weight = positive * positive;
            divisor += weight * its;
            change_x += weight * unlike_x;
            change_z += weight * unlike_z;
        }
        const float share = 1.0f / (1 << L3_OUTPUT_FRACTION) / divisor;
        to[x] = changed(own[x], change_x * share);
        to[2 * stride + x] = changed(own[2 * span + x], change_z * share);
    }
}

#ifdef L3_LEAST_REACH
/* Returns the lower limit of a pixel's luminance, from the raw values around it, in output steps. */
static float least_luminance(const uint16_t *padded, int row, int x, int rows, int columns, int phase_row, int phase_column) {
    const ptrdiff_t span = padded_span(columns);
    const int bottom = smaller(row + L3_LEAST_REACH, rows - 1), right = smaller(x + L3_LEAST_REACH, columns - 1);
    const int top = row > L3_LEAST_REACH ? row - L3_LEAST_REACH : 0, left = x > L3_LEAST_REACH ? x - L3_LEAST_REACH : 0;
    float smallest = 0;
    for (int r = top; r <= bottom; r++)
        for (int c = left; c <= right; c++) {
            const int channel = l3_cfa[(r + phase_row) % L3_CFA_ROWS][(c + phase_column) % L3_CFA_COLUMNS];
            const float above_black = (float)padded[(r + L3_RADIUS) * span + c + L3_RADIUS] - L3_LEAST_BLACK_LEVEL;
            const float level = above_black * l3_white_scale[channel];
            if ((r == top && c == left) || level < smallest) smallest = level;
        }
    return smallest * (smallest > 0 ? L3_LEAST_OF_POSITIVE : L3_LEAST_OF_NEGATIVE) * (1 << L3_OUTPUT_FRACTION);
}

/* Raises the luminance of pixels in a row that are much darker than the raw values around them. Their chroma moves towards the chroma of
 * their diagonal neighbours. */
static void raise_row(const Smoothing *s, const uint16_t *padded, int row, int rows, int columns, int phase_row, int phase_column,
                      ptrdiff_t stride, L3Output *to) {
    const ptrdiff_t span = s->span;
    const L3Output *above = made_row(s, mirrored(row - 1, rows, 1)) + REACHED, *below = made_row(s, mirrored(row + 1, rows, 1)) + REACHED;
    for (int x = 0; x < columns; x++) {
        const float least = least_luminance(padded, row, x, rows, columns, phase_row, phase_column), luminance = (float)to[stride + x];
        if (least <= luminance) continue;
        float diagonal[3];
        for (int o = 0; o < 3; o++)
            diagonal[o] = (float)above[o * span + x - 1] + (float)above[o * span + x + 1] + (float)below[o * span + x - 1]
                        + (float)below[o * span + x + 1];
        const float brighter = diagonal[1] > least ? diagonal[1] : least, divisor = brighter > L3_DARKEST ? brighter : L3_DARKEST;
        const float share = least / divisor, most = L3_RAISED_CHROMA * (least - luminance), unit = 1.0f / (1 << L3_OUTPUT_FRACTION);
        for (int o = 0; o < 3; o += 2) {
            const float change = share * diagonal[o] - (float)to[o * stride + x];
            to[o * stride + x] = changed(to[o * stride + x], (change < -most ? -most : change > most ? most : change) * unit);
        }
        to[stride + x] = changed(to[stride + x], (least - luminance) * unit);
    }
}
#endif

/* Averages the chroma of each pixel with neighbours of similar luminance and chroma. Then raises the luminance of pixels that are much
 * darker than the raw values around them. */
static void smooth_outputs(const Smoothing *s, const uint16_t *padded, int rows, int columns, int phase_row, int phase_column,
                           L3Output *outputs) {
    for (int row = 0; row < REACHED && row < rows; row++) keep_row(s, row, rows, columns, outputs);
    for (int row = 0; row < rows; row++) {
        if (row + REACHED < rows) keep_row(s, row + REACHED, rows, columns, outputs);
        smooth_row(s, row, rows, columns, (ptrdiff_t)rows * columns, outputs + (ptrdiff_t)row * columns);
#ifdef L3_LEAST_REACH
        raise_row(s, padded, row, rows, columns, phase_row, phase_column, (ptrdiff_t)rows * columns, outputs + (ptrdiff_t)row * columns);
#else
        (void)padded, (void)phase_row, (void)phase_column;
#endif
    }
}

