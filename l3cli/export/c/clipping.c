
/* --------------------------------------------------------------------------------------------------- uniform clipped areas */

#define MAPS 8
#define CLIP_BLOCKS(length, side) (((length) + (side) - 1) / (side))

/* Values of blocks of whole CFA periods. README.md ("Uniform clipped areas", "Hue of clipped areas") contains the formulas. */
typedef struct {
    float *means; /* (block row, block column, channel + 1) means as fractions of full scale, then the largest range of a channel,
                     or -1 if the block is too dark or lacks a channel */
    float *maps;  /* (block row, block column, MAPS) w and the three values q, then c, x and z of the formulas, then f */
    float *estimates[2]; /* (block row, block column, channel + 1) estimated signals, before and after a step, then their reliability,
                            or -1 if no channel clips or all channels clip */
} Clipping;

static Clipping clipping_in(Room *room, int rows, int columns) {
    const uint64_t blocks = (uint64_t)CLIP_BLOCKS(rows, L3_CLIP_ROWS) * (uint64_t)CLIP_BLOCKS(columns, L3_CLIP_COLUMNS);
    Clipping c;
    c.means = take(room, blocks * (L3_CHANNELS + 1), sizeof *c.means);
    c.maps = take(room, blocks * MAPS, sizeof *c.maps);
    for (int i = 0; i < 2; i++) c.estimates[i] = take(room, blocks * (L3_CHANNELS + 1), sizeof *c.estimates[i]);
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

/* Estimates the brightness from channel signals, some of which may be clipped. White has the brightness 1. */
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
        const float weight = factor * smooth_step(signal[c], L3_CLIP_CORRECTED, L3_CLIP_CLIPS);
        const float *response = l3_clip_response + (c + 1) * (L3_CHANNELS + 1) * 3;
        for (int o = 0; o < 3; o++) {
            float sum = response[L3_CHANNELS * 3 + o];
            for (int s = 0; s < L3_CHANNELS; s++) sum += signal[s] * response[s * 3 + o];
            added[o] += weight * sum;
        }
    }
}

/* Computes the fraction, the replacement and the uniformity of block (y, x). */
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
    map[7] = plain;
    map[0] = plain * smooth_step(brightest, L3_CLIP_KEPT, L3_CLIP_REPLACED);
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float seen = level * l3_clip_white[c];
        grey[c] = seen < 1 ? seen : 1;
        for (int o = 0; o < 3; o++) map[1 + o] += map[0] * (signal[c] - grey[c] + seen) * l3_clip_response[c * 3 + o];
    }
    add_clipped(signal, map[0], map + 1);
    add_clipped(grey, -map[0], map + 1);
}

/* A block in which some channels clip, but not all. */
typedef struct {
    float own[L3_CHANNELS];     /* signals, at least L3_HUE_DARKEST */
    float clipped[L3_CHANNELS]; /* degree to which each channel clips */
    float most, least;          /* the largest and the smallest of these degrees */
} Clipped;

static Clipped clipped_block(const float *signal) {
    Clipped b = {{0}, {0}, 0, 1};
    for (int c = 0; c < L3_CHANNELS; c++) {
        b.own[c] = signal[c] > L3_HUE_DARKEST ? signal[c] : L3_HUE_DARKEST;
        b.clipped[c] = smooth_step(signal[c], L3_CLIP_KEPT, L3_CLIP_REPLACED);
        if (b.clipped[c] > b.most) b.most = b.clipped[c];
        if (b.clipped[c] < b.least) b.least = b.clipped[c];
    }
    return b;
}

/* Returns the factor that best scales the signals of another block to those of the clipped block `b`, and computes the likeness of both
   after scaling. */
static float scale_to(const Clipped *b, const float *signal, float *likeness) {
    float sum = 0, squares = L3_CLIP_FAINTEST, difference = 0;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float ratio = signal[c] / b->own[c];
        sum += (1 - b->clipped[c]) * ratio;
        squares += (1 - b->clipped[c]) * ratio * ratio;
    }
    const float scale = sum / squares;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float missing = 1 - scale * signal[c] / b->own[c], lacking = missing > 0 ? missing : 0;
        difference += (1 - b->clipped[c]) * missing * missing + b->clipped[c] * lacking * lacking;
    }
    *likeness = difference < L3_HUE_DIFFERENCE ? 1 - difference / L3_HUE_DIFFERENCE : 0;
    return scale;
}

/* Estimates the signals that the block `b` would have without clipping, as the mixture of `colour` and white that best fits the unclipped
   channels. */
static void estimate(const Clipped *b, const float *colour, float *made) {
    float squares = L3_CLIP_FAINTEST, scale = 0, white_scale = 0, rests = L3_HUE_WHITE_DOUBT, added = 0;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float ratio = colour[c] / b->own[c], part = (1 - b->clipped[c]) * ratio;
        squares += part * ratio;
        scale += part;
        white_scale += part * l3_clip_white[c] / b->own[c];
    }
    scale /= squares;
    white_scale /= squares;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float ratio = colour[c] / b->own[c], rest = l3_clip_white[c] / b->own[c] - white_scale * ratio;
        rests += (1 - b->clipped[c]) * rest * rest;
        added += (1 - b->clipped[c]) * rest * (1 - scale * ratio);
    }
    added = added > 0 ? added / rests : 0;
    const float kept = scale - added * white_scale > 0 ? scale - added * white_scale : 0;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float mixed = kept * colour[c] + added * l3_clip_white[c];
        made[c] = (1 - b->clipped[c]) * b->own[c] + b->clipped[c] * (mixed > b->own[c] ? mixed : b->own[c]);
    }
}

/* Estimates the signals of block (y, x) from similar unclipped blocks nearby, and the reliability of the estimate. */
static void estimate_block(const float *means, int y, int x, int rows, int columns, float *made) {
    const Clipped block = clipped_block(means + ((ptrdiff_t)y * columns + x) * (L3_CHANNELS + 1));
    float total[L3_CHANNELS] = {0}, likeness = 0, alike;
    made[L3_CHANNELS] = -1;
    if (block.most <= 0 || block.least >= 1) return;
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
            const float scale = scale_to(&block, there, &alike);
            const float weight = (float)near / L3_HUE_WEIGHTS * open * open * alike * alike;
            likeness += weight;
            for (int c = 0; c < L3_CHANNELS; c++) total[c] += weight * scale * there[c];
        }
    (void)scale_to(&block, l3_clip_white, &alike);
    const float open = (1 - block.most) * (1 - block.most);
    const float found = likeness / (likeness + L3_HUE_DOUBT + L3_HUE_GREY_DOUBT * alike * alike);
    made[L3_CHANNELS] = (1 - block.least) * (found > open ? found : open);
    for (int c = 0; c < L3_CHANNELS; c++) made[c] = block.own[c];
    if (likeness <= 0) return;
    for (int c = 0; c < L3_CHANNELS; c++) total[c] /= likeness;
    estimate(&block, total, made);
}

/* Distances in blocks over which the passes spread the estimates */
static const int spread_rows[L3_SPREADS] = {L3_SPREAD_ROWS}, spread_columns[L3_SPREADS] = {L3_SPREAD_COLUMNS};

static float within_hue(float ratio) { return ratio < 0 ? 0 : ratio > L3_HUE_MOST ? L3_HUE_MOST : ratio; }

/* Spreads the estimates `from` over uniform areas, by `down` rows and `across` columns of blocks, and stores the new estimate of block
   (y, x) in `to`. The last pass also stores the hue in `maps`, and adds the estimated outputs to the first four maps. */
static void spread_block(const float *means, const float *from, int y, int x, int rows, int columns, int down, int across, int last,
                         float *to, float *maps) {
    const ptrdiff_t at = (ptrdiff_t)y * columns + x;
    const float *own = from + at * (L3_CHANNELS + 1);
    float *made = to + at * (L3_CHANNELS + 1), *map = maps + at * MAPS;
    float total[L3_CHANNELS], best = own[L3_CHANNELS], likeness = best, alike;
    made[L3_CHANNELS] = best;
    if (best < 0) return;
    const Clipped block = clipped_block(means + at * (L3_CHANNELS + 1));
    for (int c = 0; c < L3_CHANNELS; c++) total[c] = best * own[c];
    for (int n = 0; n < 9; n++) {
        const int i = n / 3 - 1, j = n % 3 - 1, row = y + i * down, column = x + j * across;
        if (n == 4 || row < 0 || row >= rows || column < 0 || column >= columns) continue;
        const ptrdiff_t there = (ptrdiff_t)row * columns + column;
        const ptrdiff_t between = (ptrdiff_t)(y + i * (down / 2)) * columns + x + j * (across / 2);
        const float *mean = means + there * (L3_CHANNELS + 1), *estimated = from + there * (L3_CHANNELS + 1);
        float reliable = estimated[L3_CHANNELS], change = 0, opens = L3_CLIP_FAINTEST, brightest = 0;
        for (int c = 0; c < L3_CHANNELS; c++) {
            const float differs = 1 - mean[c] / block.own[c];
            if (mean[c] > brightest) brightest = mean[c];
            change += (1 - block.clipped[c]) * differs * differs;
            opens += 1 - block.clipped[c];
        }
        if (reliable < 0) {
            estimated = mean;
            reliable = brightest > 0 && brightest <= L3_CLIP_KEPT ? 1 : 0;
        }
        const float scale = scale_to(&block, estimated, &alike), same = alike - change / opens / L3_SPREAD_CHANGE;
        float weight = map[7] * maps[between * MAPS + 7] * maps[there * MAPS + 7] * (1 - block.least) * reliable * (same > 0 ? same : 0);
        if (weight > best) best = weight;
        weight *= i && j ? 0.25f : 0.5f;
        likeness += weight;
        for (int c = 0; c < L3_CHANNELS; c++) total[c] += weight * scale * estimated[c];
    }
    made[L3_CHANNELS] = best;
    for (int c = 0; c < L3_CHANNELS; c++) made[c] = block.own[c];
    if (likeness > 0) {
        for (int c = 0; c < L3_CHANNELS; c++) total[c] /= likeness;
        estimate(&block, total, made);
    }
    if (!last) return;
    float output[3] = {0}, lost = 0, whole = 0;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const float by = l3_clip_response[c * 3 + 1], part = (by < 0 ? -by : by) * l3_clip_white[c];
        lost += part * block.clipped[c];
        whole += part;
        for (int o = 0; o < 3; o++) output[o] += made[c] * l3_clip_response[c * 3 + o];
    }
    const float range = means[at * (L3_CHANNELS + 1) + L3_CHANNELS], smooth = 1 - smooth_step(range, L3_CLIP_PLAIN, L3_CLIP_TEXTURED);
    lost *= best * (smooth - map[7]) / whole;
    for (int m = 0; m < 4; m++) map[m] = (1 - lost) * map[m] + lost * (m ? output[m - 1] : 1);
    const float tiny = L3_CLIP_FAINTEST * L3_CLIP_FAINTEST, luminance = output[1] > tiny ? output[1] : tiny;
    map[4] = block.most * best;
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
            map_block(c->means, y, x, down, across, c->maps + ((ptrdiff_t)y * across + x) * MAPS);
            estimate_block(c->means, y, x, down, across, c->estimates[0] + ((ptrdiff_t)y * across + x) * (L3_CHANNELS + 1));
        }
    for (int step = 0; step < L3_SPREADS; step++)
        for (int y = 0; y < down; y++)
            for (int x = 0; x < across; x++)
                spread_block(c->means, c->estimates[step % 2], y, x, down, across, spread_rows[step], spread_columns[step],
                             step == L3_SPREADS - 1, c->estimates[1 - step % 2], c->maps);
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
