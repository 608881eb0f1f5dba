// Corrects colours where channels clip (l3cli/classes/clipping.py). From the channel means and the range of each block in the mosaic, the kernels
// compute seven maps, which are interpolated at quads of 2 × 2 pixels:
// 0        the fraction of the outputs to replace, in uniform areas and where clipped channels contain most of the luminance
// 1 to 3   the replacements for X, Y and Z, times map 0
// 4        the degree to which a pixel gets the hue of similar unclipped blocks
// 5 and 6  X/Y and Z/Y of the new hue, times map 4
//
// Statistics, uniformities and estimates of blocks are planes (value, block row, block column). Block maps are float8, with an unused last
// value. Functions with the parameters (y, x) process LANES blocks in row y, beginning at column x.

// These macros and functions replace max, min and clamp, which are slow function calls in PoCL 3.0.
#define MORE(a, b) ((a) > (b) ? (a) : (b))
#define LESS(a, b) ((a) < (b) ? (a) : (b))
#define WITHIN(value, low, high) LESS(MORE(value, low), high)
#define MEANS (CHANNELS + 1)  // values per block: the mean of each channel, and the largest range of any channel

INLINE floats more_of(floats a, floats b) { return a > b ? a : b; }
INLINE floats less_of(floats a, floats b) { return a < b ? a : b; }

INLINE floats smooth_step(floats value, float low, float high) {
    const floats share = (value - low) * (1.0f / (high - low)), part = less_of(more_of(share, 0.0f), 1.0f);
    return part * part * (3.0f - 2.0f * part);
}

// Reads LANES blocks in a row from column x, with zeros outside the row.
INLINE floats blocks_at(__global const float *row, int x, int columns) {
#if LANES == 1
    return x >= 0 && x < columns ? row[x] : 0.0f;
#else
    if (x >= 0 && x + LANES <= columns) return LOAD_GLOBAL(floats, row + x);
    float value[LANES];
    AT_EDGE
    for (int i = 0; i < LANES; i++) value[i] = x + i >= 0 && x + i < columns ? row[x + i] : 0.0f;
    return LOAD_PRIVATE(floats, value);
#endif
}

// Reads LANES blocks in a row from column x. Outside the row, the first and last blocks are repeated.
INLINE floats repeated_blocks_at(__global const float *row, int x, int columns) {
#if LANES == 1
    return row[WITHIN(x, 0, columns - 1)];
#else
    if (x >= 0 && x + LANES <= columns) return LOAD_GLOBAL(floats, row + x);
    float value[LANES];
    AT_EDGE
    for (int i = 0; i < LANES; i++) value[i] = row[WITHIN(x + i, 0, columns - 1)];
    return LOAD_PRIVATE(floats, value);
#endif
}

INLINE void store_blocks(__global float *row, int x, int columns, floats value) {
#if LANES == 1
    row[x] = value;
#else
    STORE_FIRST(row + x, value, columns - x);
#endif
}

// Rows and columns of a block inside the frame.
typedef struct {
    int top, bottom, left, right;
} Block;

INLINE Block block_at(int y, int x, int frame_rows, int frame_columns) {
    const int top = LESS(y * BLOCK_ROWS, frame_rows - BLOCK_ROWS), left = LESS(x * BLOCK_COLUMNS, frame_columns - BLOCK_COLUMNS);
    Block block = {MORE(top, 0), LESS(MORE(top, 0) + BLOCK_ROWS, frame_rows), MORE(left, 0),
                   LESS(MORE(left, 0) + BLOCK_COLUMNS, frame_columns)};
    return block;
}

INLINE int brightest_of(Block block, __global const ushort *restrict raw, int first, int frame_columns) {
    int brightest = 0;
    for (int r = block.top; r < block.bottom; r++)
        for (int c = block.left; c < block.right; c++) {
            const int value = raw[(size_t)(r - first) * frame_columns + c];
            brightest = MORE(brightest, value);
        }
    return brightest;
}

#define NO_RANGE (-1.0f)  // range of blocks that are ignored, whose means are zero

// Computes the channel means of a block and the largest range of any channel, as fractions of full scale. A block that lacks a channel is
// ignored.
INLINE void measure_block(float made[MEANS], Block block, __global const ushort *restrict raw, __global const uchar *restrict cfa,
                          float black_level, float span, int phase_row, int phase_column, int first, int frame_columns) {
    int sum[CHANNELS] = {0}, count[CHANNELS] = {0}, lowest[CHANNELS], highest[CHANNELS] = {0}, widest = 0;
    bool whole = true;
    for (int k = 0; k < CHANNELS; k++) lowest[k] = MAX_RAW;
    for (int r = block.top; r < block.bottom; r++)
        for (int c = block.left; c < block.right; c++) {
            const int read = raw[(size_t)(r - first) * frame_columns + c], value = LESS(read, MAX_RAW);
            const int k = cfa[(r + phase_row) % CFA_ROWS * CFA_COLUMNS + (c + phase_column) % CFA_COLUMNS];
            sum[k] += value;
            count[k]++;
            lowest[k] = LESS(lowest[k], value);
            highest[k] = MORE(highest[k], value);
        }
    for (int k = 0; k < CHANNELS; k++) {
        whole = whole && count[k] > 0;
        const float mean = ((float)sum[k] / (float)MORE(count[k], 1) - black_level) / span;
        made[k] = LESS(mean, 1.0f);
        widest = MORE(widest, highest[k] - lowest[k]);
    }
    for (int k = 0; k < CHANNELS; k++) made[k] = whole ? made[k] : 0.0f;
    made[CHANNELS] = whole ? (float)widest / span : NO_RANGE;
}

#define NOT_COUNTED(made) do { \
    for (int k_ = 0; k_ < CHANNELS; k_++) (made)[k_] = 0.0f; \
    (made)[CHANNELS] = NO_RANGE; \
} while (0)

// Estimates the brightness of blocks from their channel signals. `white` contains the signals of white, which has the brightness 1.
INLINE floats grey_level(const floats *signal, __global const float *white) {
    floats total = 0.0f, weights = 0.0f, most = 0.0f, every = 1.0f;
    for (int c = 0; c < CHANNELS; c++) {
        const floats level = signal[c] / white[c], clipped = smooth_step(signal[c], BEGINS, CLIPS);
        const floats weight = more_of(1.0f - clipped, FAINTEST);
        total += weight * level;
        weights += weight;
        most = more_of(most, level);
        every = less_of(every, clipped);
    }
    const floats mean = total / weights;
    return mean + every * (most - mean);
}

// Adds the corrections of X, Y and Z for clipped channels, weighted by `factor` times the degree to which each channel clips.
INLINE void add_clipped(floats added[3], const floats *signal, floats factor, __global const float *response) {
    for (int c = 0; c < CHANNELS; c++) {
        const floats weight = factor * smooth_step(signal[c], CORRECTED_FROM, CLIPS);
        if (!any_lane(weight != 0.0f)) continue;
        __global const float *of_channel = response + (c + 1) * (CHANNELS + 1) * 3;
        for (int o = 0; o < 3; o++) {
            floats sum = of_channel[CHANNELS * 3 + o];
            for (int k = 0; k < CHANNELS; k++) sum += signal[k] * of_channel[k * 3 + o];
            added[o] += weight * sum;
        }
    }
}

// Computes the first four maps and the uniformity of blocks. `response` is an array (clipped, signal, output), followed by the signals of
// white. Ignored blocks are skipped. So are blocks with means far below BEGINS, because uniform areas that contain them are not bright.
INLINE floats replacement_of(floats made[4], int y, int x, __global const float *restrict means, __global const float *restrict response,
                             int rows, int columns) {
    const size_t plane = (size_t)rows * columns, at = (size_t)y * columns;
    const int above = (y > 0 ? -1 : 0) * columns, below = (y < rows - 1 ? 1 : 0) * columns;
    floats widest = blocks_at(means + CHANNELS * plane + at, x, columns), brightest = 0.0f, signal[CHANNELS];
    for (int m = 0; m < 4; m++) made[m] = 0.0f;
    for (int k = 0; k < CHANNELS; k++) brightest = more_of(brightest, blocks_at(means + k * plane + at, x, columns));
    const ints counted = widest >= 0.0f && widest < TEXTURED_FROM && brightest >= BEGINS - TEXTURED_FROM;
    if (!any_lane(counted)) return made[0];
    brightest = 0.0f;
    for (int k = 0; k <= CHANNELS; k++) {
        __global const float *row = means + k * plane + at;
        const floats own = blocks_at(row, x, columns), less = k < CHANNELS ? own : (floats)0.0f;
        floats sum = 0.0f;
        for (int n = 0; n < 9; n++) {
            if (n == 4) continue;
            const floats around = repeated_blocks_at(row + (n < 3 ? above : n < 6 ? 0 : below), x + n % 3 - 1, columns);
            const floats differs = around - less;
            widest = more_of(widest, k < CHANNELS ? more_of(differs, -differs) : differs);
            sum += (n % 2 ? 0.125f : 0.0625f) * around;
        }
        if (k == CHANNELS) break;
        signal[k] = 0.25f * own + sum;
        brightest = more_of(brightest, signal[k]);
    }
    const floats plain = counted ? 1.0f - smooth_step(widest, PLAIN_UP_TO, TEXTURED_FROM) : (floats)0.0f;
    made[0] = plain * smooth_step(brightest, KEPT_UP_TO, REPLACED_FROM);
    if (!any_lane(made[0] > 0.0f)) return plain;
    __global const float *white = response + (CHANNELS + 1) * (CHANNELS + 1) * 3;
    const floats level = grey_level(signal, white);
    floats grey[CHANNELS];
    for (int k = 0; k < CHANNELS; k++) {
        const floats seen = level * white[k];
        grey[k] = less_of(seen, 1.0f);
        for (int o = 0; o < 3; o++) made[1 + o] += made[0] * (signal[k] - grey[k] + seen) * response[k * 3 + o];
    }
    add_clipped(made + 1, signal, made[0], response);
    add_clipped(made + 1, grey, -made[0], response);
    return plain;
}

// Signals of blocks, with the degree from 0 to 1 to which their channels clip.
typedef struct {
    floats own[CHANNELS];      // signals, at least MIN_SIGNAL
    floats inverse[CHANNELS];  // reciprocals of these signals
    floats open[CHANNELS];     // 1 for channels that do not clip, 0 for channels that clip
    floats most, least;        // highest and lowest degree of clipping among the channels
} Clipped;

INLINE Clipped clipped_at(__global const float *row, int x, size_t plane, int columns) {
    Clipped made;
    made.most = 0.0f;
    made.least = 1.0f;
    for (int k = 0; k < CHANNELS; k++) {
        const floats mean = blocks_at(row + k * plane, x, columns), clipped = smooth_step(mean, KEPT_UP_TO, REPLACED_FROM);
        made.own[k] = more_of(mean, MIN_SIGNAL);
        made.inverse[k] = 1.0f / made.own[k];
        made.open[k] = 1.0f - clipped;
        made.most = more_of(made.most, clipped);
        made.least = less_of(made.least, clipped);
    }
    return made;
}

// Compares clipped blocks with other blocks, which have the given signals. Returns the factors that scale these signals to the brightness of the
// clipped blocks, fitted by least squares to the channels that do not clip. Also computes the likeness, the similarity of the blocks after scaling,
// from 0 (different surfaces) to 1.
INLINE floats scale_to(const Clipped *block, const floats *signal, floats *likeness) {
    floats ratio[CHANNELS], sum = 0.0f, squares = FAINTEST, difference = 0.0f;
    for (int k = 0; k < CHANNELS; k++) {
        ratio[k] = signal[k] * block->inverse[k];
        const floats part = block->open[k] * ratio[k];
        sum += part;
        squares += part * ratio[k];
    }
    const floats scale = sum / squares;
    for (int k = 0; k < CHANNELS; k++) {
        const floats missing = 1.0f - scale * ratio[k], counted = missing > 0.0f ? (floats)1.0f : block->open[k];
        difference += counted * missing * missing;
    }
    *likeness = more_of(1.0f - difference * (1.0f / MAX_DIFFERENCE), 0.0f);
    return scale;
}

// Estimates the signals that blocks would have without clipping, as the mixture of a colour (total / likeness) and white that best fits the
// unclipped channels. If the likeness is 0, the signals do not change.
INLINE void estimate(floats *made, const Clipped *block, const floats *total, floats likeness, __global const float *white) {
    const ints known = likeness > 0.0f;
    const floats inverse = 1.0f / (known ? likeness : (floats)1.0f);
    floats colour[CHANNELS], ratio[CHANNELS], of_white[CHANNELS], squares = FAINTEST, scale = 0.0f, white_scale = 0.0f;
    floats rests = WHITE_DOUBT, added = 0.0f;
    for (int k = 0; k < CHANNELS; k++) {
        colour[k] = total[k] * inverse;
        ratio[k] = colour[k] * block->inverse[k];
        of_white[k] = white[k] * block->inverse[k];
        const floats part = block->open[k] * ratio[k];
        squares += part * ratio[k];
        scale += part;
        white_scale += part * of_white[k];
    }
    scale /= squares;
    white_scale /= squares;
    for (int k = 0; k < CHANNELS; k++) {
        const floats rest = of_white[k] - white_scale * ratio[k], part = block->open[k] * rest;
        rests += part * rest;
        added += part * (1.0f - scale * ratio[k]);
    }
    added = more_of(added, 0.0f) / rests;
    const floats of_colour = more_of(scale - added * white_scale, 0.0f);
    for (int k = 0; k < CHANNELS; k++) {
        const floats mixed = of_colour * colour[k] + added * white[k], own = block->own[k];
        made[k] = known ? block->open[k] * own + (1.0f - block->open[k]) * more_of(mixed, own) : own;
    }
}

// Estimates the unclipped signals of blocks from similar unclipped blocks nearby, stores them, and returns their reliability. If no channel or
// every channel of a block clips, the reliability is NOT_ESTIMATED and the signals are undefined.
#define NOT_ESTIMATED (-1.0f)

INLINE floats store_estimates(int y, int x, __global const float *restrict means, __global const float *restrict response,
                              __global float *restrict estimates, int rows, int columns) {
    const size_t plane = (size_t)rows * columns, at = (size_t)y * columns;
    const Clipped block = clipped_at(means + at, x, plane, columns);
    const ints estimated = block.most > 0.0f && block.least < 1.0f;
    if (!any_lane(estimated)) return (floats)NOT_ESTIMATED;
    floats signal[CHANNELS], total[CHANNELS] = {0.0f}, likeness = 0.0f, alike;
    for (int i = -HUE_STEPS; i <= HUE_STEPS; i++) {
        const int line = y + i * HUE_ROWS;
        if (line < 0 || line >= rows) continue;
        for (int j = -HUE_STEPS; j <= HUE_STEPS; j++) {
            floats brightest = 0.0f;
            for (int k = 0; k < CHANNELS; k++) {
                signal[k] = blocks_at(means + k * plane + (size_t)line * columns, x + j * HUE_COLUMNS, columns);
                brightest = more_of(brightest, signal[k]);
            }
            const ints counted = brightest > 0.0f && brightest < REPLACED_FROM;
            if (!any_lane(counted)) continue;
            const floats trust = counted ? 1.0f - smooth_step(brightest, KEPT_UP_TO, REPLACED_FROM) : (floats)0.0f;
            const int near = (HUE_STEPS + 1 - (i < 0 ? -i : i)) * (HUE_STEPS + 1 - (j < 0 ? -j : j));
            const floats scale = scale_to(&block, signal, &alike);
            const floats weight = near * (1.0f / HUE_WEIGHTS) * trust * trust * alike * alike;
            likeness += weight;
            for (int k = 0; k < CHANNELS; k++) total[k] += weight * scale * signal[k];
        }
    }
    __global const float *white = response + (CHANNELS + 1) * (CHANNELS + 1) * 3;
    for (int k = 0; k < CHANNELS; k++) signal[k] = white[k];
    scale_to(&block, signal, &alike);
    const floats own = 1.0f - block.most, found = likeness / (likeness + HUE_DOUBT + GREY_DOUBT * alike * alike);
    estimate(signal, &block, total, likeness, white);
    for (int k = 0; k < CHANNELS; k++) store_blocks(estimates + k * plane + at, x, columns, signal[k]);
    return estimated ? (1.0f - block.least) * more_of(own * own, found) : (floats)NOT_ESTIMATED;
}

// Stores the first `count` values of LANES blocks in their float8.
INLINE void store_float8(__global float *restrict maps, int x, int columns, const floats *made, int count) {
#if LANES == 1
    for (int m = 0; m < count; m++) maps[8 * x + m] = made[m];
#else
    float lane[8][LANES];
    for (int m = 0; m < count; m++) STORE_PRIVATE(floats, lane[m]) = made[m];
    for (int i = 0; i < LESS(LANES, columns - x); i++)
        for (int m = 0; m < count; m++) maps[8 * (x + i) + m] = lane[m][i];
#endif
}

// Loads the first `count` values of LANES blocks from their float8.
INLINE void load_float8(floats *made, __global const float *restrict maps, int x, int columns, int count) {
#if LANES == 1
    for (int m = 0; m < count; m++) made[m] = maps[8 * x + m];
#else
    float lane[8][LANES];
    for (int i = 0; i < LANES; i++)
        for (int m = 0; m < count; m++) lane[m][i] = x + i < columns ? maps[8 * (x + i) + m] : 0.0f;
    for (int m = 0; m < count; m++) made[m] = LOAD_PRIVATE(floats, lane[m]);
#endif
}

// Each group of LANES blocks in a row has a flag. Few groups have maps, and fewer have estimates.
#define HAS_MAPS 1       // otherwise, the maps of the group are zero, but not stored
#define HAS_ESTIMATES 2  // otherwise, all blocks of the group are NOT_ESTIMATED
#define GROUP_OF(y, x, columns) ((size_t)(y) * (((columns) + LANES - 1) / LANES) + (x) / LANES)

// Stores the first four maps of blocks, their uniformity, the estimates of their signals, and the flag of the group. `spread_at` computes the
// hue maps. `others` is the second buffer for estimates, in which `spread_at` relies on NOT_ESTIMATED blocks.
INLINE void store_maps_of(int y, int x, __global const float *restrict means, __global const float *restrict response,
                          __global float *restrict maps, __global float *restrict uniformity, __global float *restrict estimates,
                          __global float *restrict others, __global uchar *restrict flags, int rows, int columns) {
    const size_t at = (size_t)y * columns, reliability = (size_t)CHANNELS * rows * columns + at;
    floats made[8] = {0.0f}, plain = 0.0f, reliable = NOT_ESTIMATED;
    if (any_lane(repeated_blocks_at(means + reliability, x, columns) != NO_RANGE)) {
        plain = replacement_of(made, y, x, means, response, rows, columns);
        reliable = store_estimates(y, x, means, response, estimates, rows, columns);
    }
    const bool estimated = any_lane(reliable != NOT_ESTIMATED), mapped = estimated || any_lane(made[0] > 0.0f);
    store_blocks(uniformity + at, x, columns, plain);
    store_blocks(estimates + reliability, x, columns, reliable);
    store_blocks(others + reliability, x, columns, reliable);
    flags[GROUP_OF(y, x, columns)] = (mapped ? HAS_MAPS : 0) | (estimated ? HAS_ESTIMATES : 0);
    if (!mapped) return;
    store_float8(maps + 8 * at, x, columns, made, 8);
}

// Spreads the estimates `from` over uniform areas, by `down` rows and `across` columns of blocks, and stores the new estimates in `to`. The
// last pass also stores the hue in `maps`, and adds the estimated outputs to the first four maps.
INLINE void spread_at(int y, int x, __global const float *restrict means, __global const float *restrict response,
                      __global const float *restrict uniformity, __global const float *restrict from, __global float *restrict to,
                      __global float *restrict maps, __global const uchar *restrict flags, int down, int across, int last, int rows,
                      int columns) {
    if (!(flags[GROUP_OF(y, x, columns)] & HAS_ESTIMATES)) return;
    const size_t plane = (size_t)rows * columns, at = (size_t)y * columns;
    floats best = blocks_at(from + CHANNELS * plane + at, x, columns), alike;
    const ints chosen = best != NOT_ESTIMATED;
    const Clipped block = clipped_at(means + at, x, plane, columns);
    floats likeness = best, signal[CHANNELS], total[CHANNELS], opens = FAINTEST;
    for (int k = 0; k < CHANNELS; k++) {
        total[k] = best * (chosen ? blocks_at(from + k * plane + at, x, columns) : (floats)0.0f);
        opens += block.open[k];
    }
    const floats own = blocks_at(uniformity + at, x, columns), plain = chosen ? own * (1.0f - block.least) : (floats)0.0f;
    const floats by_change = 1.0f / (opens * MAX_CHANGE);
    for (int n = 0; n < 9; n++) {
        const int i = n / 3 - 1, j = n % 3 - 1, line = y + i * down, right = x + j * across;
        if (n == 4 || line < 0 || line >= rows) continue;
        const size_t there = (size_t)line * columns, between = (size_t)(y + i * (down / 2)) * columns;
        floats weight = plain * blocks_at(uniformity + there, right, columns);
        weight *= blocks_at(uniformity + between, x + j * (across / 2), columns);
        if (!any_lane(weight > 0.0f)) continue;
        floats reliable = blocks_at(from + CHANNELS * plane + there, right, columns), change = 0.0f, brightest = 0.0f;
        const ints estimated = reliable != NOT_ESTIMATED;
        for (int k = 0; k < CHANNELS; k++) {
            const floats mean = blocks_at(means + k * plane + there, right, columns), differs = 1.0f - mean * block.inverse[k];
            brightest = more_of(brightest, mean);
            change += block.open[k] * differs * differs;
            signal[k] = estimated ? blocks_at(from + k * plane + there, right, columns) : mean;
        }
        const floats whole = brightest > 0.0f && brightest <= KEPT_UP_TO ? (floats)1.0f : (floats)0.0f;
        reliable = estimated ? reliable : whole;
        const floats scale = scale_to(&block, signal, &alike);
        weight *= reliable * more_of(alike - change * by_change, 0.0f);
        best = more_of(best, weight);
        weight *= i && j ? 0.25f : 0.5f;
        likeness += weight;
        for (int k = 0; k < CHANNELS; k++) total[k] += weight * scale * signal[k];
    }
    estimate(signal, &block, total, likeness, response + (CHANNELS + 1) * (CHANNELS + 1) * 3);
    store_blocks(to + CHANNELS * plane + at, x, columns, chosen ? best : (floats)NOT_ESTIMATED);
    floats output[3] = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < CHANNELS; k++) {
        store_blocks(to + k * plane + at, x, columns, signal[k]);
        for (int o = 0; o < 3; o++) output[o] += signal[k] * response[k * 3 + o];
    }
    if (!last) return;
    const floats luminance = more_of(output[1], FAINTEST * FAINTEST), taken = chosen ? block.most * best : (floats)0.0f;
    // Fraction of the outputs that the estimated outputs replace. It is large in areas that are not uniform if most of the luminance is in
    // clipped channels.
    __global const float *white = response + (CHANNELS + 1) * (CHANNELS + 1) * 3;
    floats lost = 0.0f;
    float whole = 0.0f;
    for (int k = 0; k < CHANNELS; k++) {
        const float part = MORE(response[k * 3 + 1], -response[k * 3 + 1]) * white[k];
        lost += part * (1.0f - block.open[k]);
        whole += part;
    }
    const floats smooth = 1.0f - smooth_step(blocks_at(means + CHANNELS * plane + at, x, columns), PLAIN_UP_TO, TEXTURED_FROM);
    lost = chosen ? best * (smooth - own) * lost / whole : (floats)0.0f;
    floats made[7];
    load_float8(made, maps + 8 * at, x, columns, 4);
    for (int m = 0; m < 4; m++) made[m] = (1.0f - lost) * made[m] + lost * (m ? output[m - 1] : (floats)1.0f);
    made[4] = taken;
    made[5] = taken * less_of(more_of(output[0] / luminance, 0.0f), MAX_HUE);
    made[6] = taken * less_of(more_of(output[2] / luminance, 0.0f), MAX_HUE);
    store_float8(maps + 8 * at, x, columns, made, 7);
}

// Position of a quad between two block centres along one axis.
typedef struct {
    int low, high;  // the two blocks
    float share;    // weight of the block `high`
} Between;

INLINE Between between(int pixel, int side, int blocks) {
    // In half pixels, and shifted by one block so that it is positive.
    const int place = 2 * pixel + 2 + side, low = place / (2 * side) - 1;
    Between made = {WITHIN(low, 0, blocks - 1), WITHIN(low + 1, 0, blocks - 1), (float)(place % (2 * side)) / (2 * side)};
    return made;
}

// Returns the maps of the block in row y and column x.
INLINE float8 maps_of(__global const float8 *maps, __global const uchar *flags, int y, int x, int columns) {
    return flags[GROUP_OF(y, x, columns)] ? maps[(size_t)y * columns + x] : (float8)0.0f;
}

// Interpolates the maps of column x between two rows.
INLINE float8 maps_between_rows(Between down, __global const float8 *maps, __global const uchar *flags, int x, int columns) {
    const float8 above = maps_of(maps, flags, down.low, x, columns);
    return above + down.share * (maps_of(maps, flags, down.high, x, columns) - above);
}

// Stores the maps of a quad. `to` is its map 0.
INLINE void store_maps(__global float *restrict to, float8 made) {
    to[OF_MAP(0)] = made.s0;
    to[OF_MAP(1)] = made.s1;
    to[OF_MAP(2)] = made.s2;
    to[OF_MAP(3)] = made.s3;
    to[OF_MAP(4)] = made.s4;
    to[OF_MAP(5)] = made.s5;
    to[OF_MAP(6)] = made.s6;
}
