
/* --------------------------------------------------------------------------------------------------- uniform clipped areas */

#define MAPS 7
#define CLIP_BLOCKS(length, side) (((length) + (side) - 1) / (side))

/* Values of blocks of whole CFA periods. README.md ("Uniform clipped areas", "Hue of clipped areas") contains the formulas. */
typedef struct {
    float *means; /* (block row, block column, channel + 1) means as fractions of full scale, then the largest range of a channel,
                     or -1 if the block is too dark or lacks a channel */
    float *maps;  /* (block row, block column, MAPS) w and the three values q, then c, x and z of the formulas */
} Clipping;

static Clipping clipping_in(Room *room, int rows, int columns) {
    const uint64_t blocks = (uint64_t)CLIP_BLOCKS(rows, L3_CLIP_ROWS) * (uint64_t)CLIP_BLOCKS(columns, L3_CLIP_COLUMNS);
    Clipping c;
    c.means = take(room, blocks * (L3_CHANNELS + 1), sizeof *c.means);
    c.maps = take(room, blocks * MAPS, sizeof *c.maps);
    return c;
}

static float smooth_step(float value, float low, float high) {
    const float share = (value - low) / (high - low), part = share < 0 ? 0 : share > 1 ? 1 : share;
    return part * part * (3 - 2 * part);
}

/* Computes the means and the largest range of block (y, x) of the padded mosaic. */
static void measure_block(const uint16_t *padded, int y, int x, int rows, int columns, int phase_row, int phase_column, float *made) {
    const ptrdiff_t span = padded_span(columns);
    const int last_top = rows > L3_CLIP_ROWS ? rows - L3_CLIP_ROWS : 0, top = smaller(y * L3_CLIP_ROWS, last_top);
    const int last_left = columns > L3_CLIP_COLUMNS ? columns - L3_CLIP_COLUMNS : 0, left = smaller(x * L3_CLIP_COLUMNS, last_left);
    int sum[L3_CHANNELS] = {0}, count[L3_CHANNELS] = {0}, lowest[L3_CHANNELS], highest[L3_CHANNELS] = {0};
    int brightest = 0, widest = 0, whole = 1;
    for (int c = 0; c < L3_CHANNELS; c++) lowest[c] = L3_MOST_DN;
    for (int r = top; r < smaller(top + L3_CLIP_ROWS, rows); r++)
        for (int p = left; p < smaller(left + L3_CLIP_COLUMNS, columns); p++) {
            const int value = padded[(r + L3_RADIUS) * span + p + L3_RADIUS];
            const int c = l3_cfa[(r + phase_row) % L3_CFA_ROWS][(p + phase_column) % L3_CFA_COLUMNS];
            sum[c] += value;
            count[c]++;
            lowest[c] = smaller(lowest[c], value);
            if (value > highest[c]) highest[c] = value;
            if (value > brightest) brightest = value;
        }
    for (int c = 0; c < L3_CHANNELS; c++) {
        whole &= count[c] > 0;
        if (highest[c] - lowest[c] > widest) widest = highest[c] - lowest[c];
    }
    whole &= brightest >= L3_CLIP_BRIGHT;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float mean = whole ? ((float)sum[c] / (float)count[c] - L3_BLACK_LEVEL) / (L3_WHITE_LEVEL - L3_BLACK_LEVEL) : 0;
        made[c] = mean > 1 ? 1 : mean;
    }
    made[L3_CHANNELS] = whole ? (float)widest / (L3_WHITE_LEVEL - L3_BLACK_LEVEL) : -1;
}

/* Estimates the brightness of signals (channel), of which some may be clipped. A white has a brightness of 1. */
static float grey_level(const float *signal) {
    float total = 0, weights = 0, most = 0, every = 1;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float level = signal[c] / l3_clip_white[c], clipped = smooth_step(signal[c], L3_CLIP_BEGINS, L3_CLIP_CLIPS);
        const float weight = 1 - clipped > L3_CLIP_FAINTEST ? 1 - clipped : L3_CLIP_FAINTEST;
        total += weight * level;
        weights += weight;
        if (level > most) most = level;
        if (clipped < every) every = clipped;
    }
    return total / weights + every * (most - total / weights);
}

/* Adds the contributions of clipped channels to the outputs, times a factor. */
static void add_clipped(const float *signal, float factor, float *added) {
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float weight = factor * smooth_step(signal[c], L3_CLIP_BEGINS, L3_CLIP_CLIPS);
        const float *response = l3_clip_response + (c + 1) * (L3_CHANNELS + 1) * 3;
        for (int o = 0; o < 3; o++) {
            float sum = response[L3_CHANNELS * 3 + o];
            for (int s = 0; s < L3_CHANNELS; s++) sum += signal[s] * response[s * 3 + o];
            added[o] += weight * sum;
        }
    }
}

/* Computes the fraction and the replacement of block (y, x). */
static void map_block(const float *means, int y, int x, int rows, int columns, float *map) {
    const float *own = means + ((ptrdiff_t)y * columns + x) * (L3_CHANNELS + 1);
    float signal[L3_CHANNELS] = {0}, grey[L3_CHANNELS], brightest = 0, widest = 0;
    for (int m = 0; m < MAPS; m++) map[m] = 0;
    if (own[L3_CHANNELS] < 0) return;
    for (int n = 0; n < 9; n++) {
        const int row = clamped(y + n / 3 - 1, 0, rows - 1), column = clamped(x + n % 3 - 1, 0, columns - 1);
        const float *there = means + ((ptrdiff_t)row * columns + column) * (L3_CHANNELS + 1);
        for (int c = 0; c < L3_CHANNELS; c++) {
            const float differs = there[c] > own[c] ? there[c] - own[c] : own[c] - there[c];
            if (differs > widest) widest = differs;
            signal[c] += there[c] * (n == 4 ? 0.25f : n % 2 ? 0.125f : 0.0625f);
        }
        if (there[L3_CHANNELS] > widest) widest = there[L3_CHANNELS];
    }
    for (int c = 0; c < L3_CHANNELS; c++)
        if (signal[c] > brightest) brightest = signal[c];
    const float plain = 1 - smooth_step(widest, L3_CLIP_PLAIN, L3_CLIP_TEXTURED), level = grey_level(signal);
    map[0] = plain * smooth_step(brightest, L3_CLIP_KEPT, L3_CLIP_REPLACED);
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float seen = level * l3_clip_white[c];
        grey[c] = seen < 1 ? seen : 1;
        for (int o = 0; o < 3; o++) map[1 + o] += map[0] * (signal[c] - grey[c] + seen) * l3_clip_response[c * 3 + o];
    }
    add_clipped(signal, plain, map + 1);
    add_clipped(grey, -plain, map + 1);
}

/* Returns the factor that scales `signal`, the signals of a block, to `own`, the signals of a clipped block. Computes the likeness of the
   scaled signals to the signals of the clipped block, in which each channel clips to the degree `clipped`. */
static float scale_to(const float *own, const float *clipped, const float *signal, float *likeness) {
    float sum = 0, squares = L3_CLIP_FAINTEST, difference = 0;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float ratio = signal[c] / own[c];
        sum += (1 - clipped[c]) * ratio;
        squares += (1 - clipped[c]) * ratio * ratio;
    }
    const float scale = sum / squares;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float missing = 1 - scale * signal[c] / own[c], lacking = missing > 0 ? missing : 0;
        difference += (1 - clipped[c]) * missing * missing + clipped[c] * lacking * lacking;
    }
    const float alike = 1 - difference / L3_HUE_DIFFERENCE;
    *likeness = alike > 0 ? alike * alike : 0;
    return scale;
}

static float within_hue(float ratio) { return ratio < 0 ? 0 : ratio > L3_HUE_MOST ? L3_HUE_MOST : ratio; }

/* Computes the last three values of `map`, the hue of similar unclipped blocks near block (y, x). The three values must be 0 before. */
static void map_hue(const float *means, int y, int x, int rows, int columns, float *map) {
    const float *signal = means + ((ptrdiff_t)y * columns + x) * (L3_CHANNELS + 1);
    float own[L3_CHANNELS], clipped[L3_CHANNELS], total[L3_CHANNELS] = {0}, most = 0, least = 1, likeness = 0, alike;
    for (int c = 0; c < L3_CHANNELS; c++) {
        own[c] = signal[c] > L3_HUE_DARKEST ? signal[c] : L3_HUE_DARKEST;
        clipped[c] = smooth_step(signal[c], L3_CLIP_KEPT, L3_CLIP_REPLACED);
        if (clipped[c] > most) most = clipped[c];
        if (clipped[c] < least) least = clipped[c];
    }
    if (most <= 0 || least >= 1) return;
    for (int i = -L3_HUE_STEPS; i <= L3_HUE_STEPS; i++)
        for (int j = -L3_HUE_STEPS; j <= L3_HUE_STEPS; j++) {
            const int row = y + i * L3_HUE_ROWS, column = x + j * L3_HUE_COLUMNS;
            if (row < 0 || row >= rows || column < 0 || column >= columns) continue;
            const float *there = means + ((ptrdiff_t)row * columns + column) * (L3_CHANNELS + 1);
            float brightest = 0;
            for (int c = 0; c < L3_CHANNELS; c++)
                if (there[c] > brightest) brightest = there[c];
            const float open = 1 - smooth_step(brightest, L3_CLIP_KEPT, L3_CLIP_REPLACED);
            const int near = (L3_HUE_STEPS + 1 - (i < 0 ? -i : i)) * (L3_HUE_STEPS + 1 - (j < 0 ? -j : j));
            const float scale = scale_to(own, clipped, there, &alike);
            const float weight = (float)near / L3_HUE_WEIGHTS * open * open * alike;
            likeness += weight;
            for (int c = 0; c < L3_CHANNELS; c++) total[c] += weight * scale * there[c];
        }
    if (likeness <= 0) return;
    (void)scale_to(own, clipped, l3_clip_white, &alike);
    float output[3] = {0};
    for (int c = 0; c < L3_CHANNELS; c++)
        for (int o = 0; o < 3; o++) output[o] += total[c] * l3_clip_response[c * 3 + o];
    const float tiny = L3_CLIP_FAINTEST * L3_CLIP_FAINTEST, luminance = output[1] > tiny ? output[1] : tiny;
    map[4] = most * (1 - least) * likeness / (likeness + L3_HUE_DOUBT + L3_HUE_GREY_DOUBT * alike);
    map[5] = map[4] * within_hue(output[0] / luminance);
    map[6] = map[4] * within_hue(output[2] / luminance);
}

/* Returns the last block whose middle is before the middle of the pixel's 2 x 2 group, or -1. `share` is the weight of the next block. */
static int block_before(int pixel, int side, float *share) {
    const int place = 2 * (pixel / 2 * 2 + 1) + side;
    *share = (float)(place % (2 * side)) / (float)(2 * side);
    return place / (2 * side) - 1;
}

/* Replaces the outputs in uniform areas where channels clip, then changes the hue in all areas where channels clip. */
static void replace_clipped(const Clipping *c, const uint16_t *padded, int rows, int columns, int phase_row, int phase_column,
                            L3Output *outputs) {
    const int down = CLIP_BLOCKS(rows, L3_CLIP_ROWS), across = CLIP_BLOCKS(columns, L3_CLIP_COLUMNS);
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns;
    for (int y = 0; y < down; y++)
        for (int x = 0; x < across; x++)
            measure_block(padded, y, x, rows, columns, phase_row, phase_column,
                          c->means + ((ptrdiff_t)y * across + x) * (L3_CHANNELS + 1));
    for (int y = 0; y < down; y++)
        for (int x = 0; x < across; x++) {
            float *map = c->maps + ((ptrdiff_t)y * across + x) * MAPS;
            map_block(c->means, y, x, down, across, map);
            map_hue(c->means, y, x, down, across, map);
        }
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            float low, side, made[MAPS];
            const int row = block_before(y, L3_CLIP_ROWS, &low), column = block_before(x, L3_CLIP_COLUMNS, &side);
            const float *above = c->maps + (ptrdiff_t)clamped(row, 0, down - 1) * across * MAPS;
            const float *below = c->maps + (ptrdiff_t)clamped(row + 1, 0, down - 1) * across * MAPS;
            const int left = clamped(column, 0, across - 1) * MAPS, right = clamped(column + 1, 0, across - 1) * MAPS;
            for (int m = 0; m < MAPS; m++) {
                const float first = above[left + m] + low * (below[left + m] - above[left + m]);
                made[m] = first + side * (above[right + m] + low * (below[right + m] - above[right + m]) - first);
            }
            L3Output *output = outputs + (ptrdiff_t)y * columns + x;
            float by[3];
            for (int o = 0; o < 3; o++) by[o] = made[1 + o] - made[0] * ((float)output[o * pixels] / (1 << L3_OUTPUT_FRACTION));
            const float luminance = (float)output[pixels] / (1 << L3_OUTPUT_FRACTION) + by[1];
            for (int o = 0; o < 3; o += 2)
                by[o] += made[5 + o / 2] * luminance - made[4] * ((float)output[o * pixels] / (1 << L3_OUTPUT_FRACTION) + by[o]);
            for (int o = 0; o < 3; o++) output[o * pixels] = changed(output[o * pixels], by[o]);
        }
}
