// Areas where channels clip (l3cli/classes/clipping.py). The kernels compute the means and the range of each block of the mosaic. From these
// statistics they compute seven maps. Maps 0 to 3 replace the outputs in uniform areas: map 0 is the replaced fraction of the outputs, and
// maps 1 to 3 are the values added to X, Y and Z. Maps 4 to 6 then change the hue of pixels to the hue of unclipped blocks: map 4 is the
// degree of this change, and maps 5 and 6 are X/Y and Z/Y of the new hue multiplied by map 4. The maps are interpolated at quads
// (2 × 2 pixels). The eighth value of a block is its uniformity.

// Built-in functions are function calls in PoCL 3.0, and therefore slow. These macros replace max, min and clamp.
#define MORE(a, b) ((a) > (b) ? (a) : (b))
#define LESS(a, b) ((a) < (b) ? (a) : (b))
#define WITHIN(value, low, high) LESS(MORE(value, low), high)
#define MEANS (CHANNELS + 1)  // number of values per block: the mean of each channel, and the largest range of a channel

INLINE float smooth_step(float value, float low, float high) {
    const float share = (value - low) * (1.0f / (high - low)), part = WITHIN(share, 0.0f, 1.0f);
    return part * part * (3.0f - 2.0f * part);
}

// Rows and columns of a block of the mosaic. The block is inside the frame.
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

// Computes the means of the channels as fractions of full scale, and the largest range of a channel. The range of a block without pixels
// of every channel is -1. Such a block is ignored.
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
    made[CHANNELS] = whole ? (float)widest / span : -1.0f;
}

#define NOT_COUNTED(made) do { \
    for (int k_ = 0; k_ < CHANNELS; k_++) (made)[k_] = 0.0f; \
    (made)[CHANNELS] = -1.0f; \
} while (0)

// Estimates the brightness of the signals (channel) of a block. `white` contains the signals of a white, whose brightness is 1.
INLINE float grey_level(const float *signal, __global const float *white) {
    float total = 0.0f, weights = 0.0f, most = 0.0f, every = 1.0f;
    for (int c = 0; c < CHANNELS; c++) {
        const float level = signal[c] / white[c], clipped = smooth_step(signal[c], BEGINS, CLIPS), open = 1.0f - clipped;
        const float weight = MORE(open, FAINTEST);
        total += weight * level;
        weights += weight;
        most = MORE(most, level);
        every = LESS(every, clipped);
    }
    const float mean = total / weights;
    return mean + every * (most - mean);
}

// Adds the corrections of the outputs for clipped channels. The weight of each correction is `factor` times the degree to which the channel
// clips.
INLINE void add_clipped(float added[3], const float *signal, float factor, __global const float *response) {
    for (int c = 0; c < CHANNELS; c++) {
        const float weight = factor * smooth_step(signal[c], BEGINS, CLIPS);
        if (weight == 0.0f) continue;
        __global const float *of_channel = response + (c + 1) * (CHANNELS + 1) * 3;
        for (int o = 0; o < 3; o++) {
            float sum = of_channel[CHANNELS * 3 + o];
            for (int k = 0; k < CHANNELS; k++) sum += signal[k] * of_channel[k * 3 + o];
            added[o] += weight * sum;
        }
    }
}

// Computes the first four maps and the uniformity of block (y, x). `response` is (clipped, signal, output), followed by the signals of a
// white. Blocks whose means are far below BEGINS are skipped, because a uniform area that contains such a block has no bright blocks.
// Ignored blocks are also skipped, because they differ from neighbours that are not ignored. Blocks without a clipped channel are not
// skipped, because a grey of the same brightness may clip.
INLINE float4 replacement_of(int y, int x, __global const float *restrict means, __global const float *restrict response, int rows,
                             int columns, float *uniformity) {
    const size_t plane = (size_t)rows * columns, at = (size_t)y * columns + x;
    float widest = means[CHANNELS * plane + at], brightest = 0.0f, signal[MEANS];
    float4 made = 0.0f;
    for (int k = 0; k < CHANNELS; k++) brightest = MORE(brightest, means[k * plane + at]);
    if (widest < 0.0f || widest >= TEXTURED_FROM || brightest < BEGINS - TEXTURED_FROM) return made;
    const int up = (y > 0 ? -1 : 0) * columns, down = (y < rows - 1 ? 1 : 0) * columns;
    const int back = x > 0 ? -1 : 0, on = x < columns - 1 ? 1 : 0;
    brightest = 0.0f;
    for (int k = 0; k <= CHANNELS; k++) {
        __global const float *plane_of = means + k * plane + at;
        const float own = plane_of[0], around[8] = {plane_of[up + back], plane_of[up], plane_of[up + on], plane_of[back], plane_of[on],
                                                    plane_of[down + back], plane_of[down], plane_of[down + on]};
        const float less = k < CHANNELS ? own : 0.0f;
        for (int n = 0; n < 8; n++) {
            const float differs = around[n] - less;
            widest = MORE(widest, differs);
            if (k < CHANNELS) widest = MORE(widest, -differs);
        }
        signal[k] = 0.25f * own + 0.125f * (around[1] + around[3] + around[4] + around[6])
                  + 0.0625f * (around[0] + around[2] + around[5] + around[7]);
        if (k < CHANNELS) brightest = MORE(brightest, signal[k]);
    }
    const float plain = 1.0f - smooth_step(widest, PLAIN_UP_TO, TEXTURED_FROM);
    if (plain <= 0.0f) return made;
    *uniformity = plain;
    const float share = plain * smooth_step(brightest, KEPT_UP_TO, REPLACED_FROM);
    __global const float *white = response + (CHANNELS + 1) * (CHANNELS + 1) * 3;
    const float level = grey_level(signal, white);
    float grey[CHANNELS], added[3] = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < CHANNELS; k++) {
        const float seen = level * white[k];
        grey[k] = LESS(seen, 1.0f);
        for (int o = 0; o < 3; o++) added[o] += share * (signal[k] - grey[k] + seen) * response[k * 3 + o];
    }
    add_clipped(added, signal, plain, response);
    add_clipped(added, grey, -plain, response);
    return (float4)(share, added[0], added[1], added[2]);
}

// A block in which at least one channel clips and at least one channel does not clip.
typedef struct {
    float own[CHANNELS];      // signals, at least MIN_SIGNAL
    float inverse[CHANNELS];  // reciprocals of these signals
    float open[CHANNELS];     // 1 for a channel that does not clip, 0 for a channel that clips
    float most, least;        // degree of clipping of the channel that clips most, and of the channel that clips least
} Clipped;

INLINE Clipped clipped_at(size_t at, size_t plane, __global const float *restrict means) {
    Clipped made;
    made.most = 0.0f;
    made.least = 1.0f;
    for (int k = 0; k < CHANNELS; k++) {
        const float mean = means[k * plane + at], clipped = smooth_step(mean, KEPT_UP_TO, REPLACED_FROM);
        made.own[k] = MORE(mean, MIN_SIGNAL);
        made.inverse[k] = 1.0f / made.own[k];
        made.open[k] = 1.0f - clipped;
        made.most = MORE(made.most, clipped);
        made.least = LESS(made.least, clipped);
    }
    return made;
}

// Returns the factor that scales the signals of another block to the signals of a clipped block, and computes the likeness of the scaled
// signals to the signals of the clipped block.
INLINE float scale_to(const Clipped *block, const float *signal, float *likeness) {
    float ratio[CHANNELS], sum = 0.0f, squares = FAINTEST, difference = 0.0f;
    for (int k = 0; k < CHANNELS; k++) {
        ratio[k] = signal[k] * block->inverse[k];
        const float part = block->open[k] * ratio[k];
        sum += part;
        squares += part * ratio[k];
    }
    const float scale = sum / squares;
    for (int k = 0; k < CHANNELS; k++) {
        const float missing = 1.0f - scale * ratio[k], counted = missing > 0.0f ? 1.0f : block->open[k];
        difference += counted * missing * missing;
    }
    const float alike = 1.0f - difference * (1.0f / MAX_DIFFERENCE);
    *likeness = MORE(alike, 0.0f);
    return scale;
}

// Estimates the signals that a clipped block would have if no channel clipped, from the mixture of a colour and white that fits the unclipped
// channels best.
INLINE void estimate(float *made, const Clipped *block, const float *colour, __global const float *white) {
    float ratio[CHANNELS], of_white[CHANNELS], squares = FAINTEST, scale = 0.0f, white_scale = 0.0f, rests = WHITE_DOUBT, added = 0.0f;
    for (int k = 0; k < CHANNELS; k++) {
        ratio[k] = colour[k] * block->inverse[k];
        of_white[k] = white[k] * block->inverse[k];
        const float part = block->open[k] * ratio[k];
        squares += part * ratio[k];
        scale += part;
        white_scale += part * of_white[k];
    }
    scale /= squares;
    white_scale /= squares;
    for (int k = 0; k < CHANNELS; k++) {
        const float rest = of_white[k] - white_scale * ratio[k], part = block->open[k] * rest;
        rests += part * rest;
        added += part * (1.0f - scale * ratio[k]);
    }
    added = MORE(added, 0.0f) / rests;
    const float rest = scale - added * white_scale, of_colour = MORE(rest, 0.0f);
    for (int k = 0; k < CHANNELS; k++) {
        const float mixed = of_colour * colour[k] + added * white[k], own = block->own[k];
        made[k] = block->open[k] * own + (1.0f - block->open[k]) * MORE(mixed, own);
    }
}

// Estimates the signals of block (y, x) from similar unclipped blocks nearby, and stores the signals and the reliability of the estimate. If
// no channel of the block clips or all channels clip, the function stores only the reliability NOT_ESTIMATED.
#define NOT_ESTIMATED (-1.0f)

INLINE void store_estimate(int y, int x, __global const float *restrict means, __global const float *restrict response,
                           __global float *restrict estimates, int rows, int columns) {
    const size_t plane = (size_t)rows * columns, at = (size_t)y * columns + x;
    const Clipped block = clipped_at(at, plane, means);
    estimates[CHANNELS * plane + at] = NOT_ESTIMATED;
    if (block.most == 0.0f || block.least == 1.0f) return;
    float signal[CHANNELS], total[CHANNELS] = {0.0f}, likeness = 0.0f, alike;
    for (int i = -HUE_STEPS; i <= HUE_STEPS; i++)
        for (int j = -HUE_STEPS; j <= HUE_STEPS; j++) {
            const int down = y + i * HUE_ROWS, right = x + j * HUE_COLUMNS;
            if (down < 0 || down >= rows || right < 0 || right >= columns) continue;
            float brightest = 0.0f;
            for (int k = 0; k < CHANNELS; k++) {
                signal[k] = means[k * plane + (size_t)down * columns + right];
                brightest = MORE(brightest, signal[k]);
            }
            if (brightest == 0.0f || brightest >= REPLACED_FROM) continue;
            const float trust = 1.0f - smooth_step(brightest, KEPT_UP_TO, REPLACED_FROM);
            const int near = (HUE_STEPS + 1 - (i < 0 ? -i : i)) * (HUE_STEPS + 1 - (j < 0 ? -j : j));
            const float scale = scale_to(&block, signal, &alike);
            const float weight = near * (1.0f / HUE_WEIGHTS) * trust * trust * alike * alike;
            likeness += weight;
            for (int k = 0; k < CHANNELS; k++) total[k] += weight * scale * signal[k];
        }
    __global const float *white = response + (CHANNELS + 1) * (CHANNELS + 1) * 3;
    for (int k = 0; k < CHANNELS; k++) {
        total[k] = likeness > 0.0f ? total[k] / likeness : block.own[k];
        signal[k] = white[k];
    }
    scale_to(&block, signal, &alike);
    const float own = 1.0f - block.most, found = likeness / (likeness + HUE_DOUBT + GREY_DOUBT * alike * alike);
    estimates[CHANNELS * plane + at] = (1.0f - block.least) * MORE(own * own, found);
    if (likeness > 0.0f) estimate(signal, &block, total, white);
    else for (int k = 0; k < CHANNELS; k++) signal[k] = block.own[k];
    for (int k = 0; k < CHANNELS; k++) estimates[k * plane + at] = signal[k];
}

// Computes the first four maps of a block and its uniformity, and stores the estimate of its signals. The hue maps follow in `spread_at`.
INLINE float8 maps_of(int y, int x, __global const float *restrict means, __global const float *restrict response,
                      __global float *restrict estimates, int rows, int columns) {
    float plain = 0.0f;
    const float4 replacement = replacement_of(y, x, means, response, rows, columns, &plain);
    store_estimate(y, x, means, response, estimates, rows, columns);
    return (float8)(replacement, 0.0f, 0.0f, 0.0f, plain);
}

// Spreads the estimates `from` over uniform areas by one step: stores the new estimate of block (y, x) in `to`, and its hue in `maps`.
INLINE void spread_at(int y, int x, __global const float *restrict means, __global const float *restrict response,
                      __global const float *restrict from, __global float *restrict to, __global float *restrict maps, int rows,
                      int columns) {
    const size_t plane = (size_t)rows * columns, at = (size_t)y * columns + x;
    float best = from[CHANNELS * plane + at], likeness = best, signal[CHANNELS], total[CHANNELS], alike;
    to[CHANNELS * plane + at] = best;
    if (best == NOT_ESTIMATED) return;
    const Clipped block = clipped_at(at, plane, means);
    for (int k = 0; k < CHANNELS; k++) total[k] = best * from[k * plane + at];
    const float plain = maps[8 * at + 7] * (1.0f - block.least);
    for (int n = 0; n < 9 && plain > 0.0f; n++) {
        const int i = n / 3 - 1, j = n % 3 - 1, down = y + i * SPREAD_ROWS, right = x + j * SPREAD_COLUMNS;
        if (n == 4 || down < 0 || down >= rows || right < 0 || right >= columns) continue;
        const size_t there = (size_t)down * columns + right;
        const size_t between = (size_t)(y + i * (SPREAD_ROWS / 2)) * columns + x + j * (SPREAD_COLUMNS / 2);
        float reliable = from[CHANNELS * plane + there], change = 0.0f, opens = FAINTEST, brightest = 0.0f;
        const bool estimated = reliable != NOT_ESTIMATED;
        for (int k = 0; k < CHANNELS; k++) {
            const float mean = means[k * plane + there], differs = 1.0f - mean * block.inverse[k];
            brightest = MORE(brightest, mean);
            change += block.open[k] * differs * differs;
            opens += block.open[k];
            signal[k] = estimated ? from[k * plane + there] : mean;
        }
        if (!estimated) reliable = brightest > 0.0f && brightest <= KEPT_UP_TO ? 1.0f : 0.0f;
        const float scale = scale_to(&block, signal, &alike), same = alike - change / opens * (1.0f / MAX_CHANGE);
        float weight = plain * maps[8 * between + 7] * maps[8 * there + 7] * reliable * MORE(same, 0.0f);
        best = MORE(best, weight);
        weight *= i && j ? 0.25f : 0.5f;
        likeness += weight;
        for (int k = 0; k < CHANNELS; k++) total[k] += weight * scale * signal[k];
    }
    if (likeness > 0.0f) {
        for (int k = 0; k < CHANNELS; k++) total[k] /= likeness;
        estimate(signal, &block, total, response + (CHANNELS + 1) * (CHANNELS + 1) * 3);
    } else
        for (int k = 0; k < CHANNELS; k++) signal[k] = block.own[k];
    to[CHANNELS * plane + at] = best;
    float output[3] = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < CHANNELS; k++) {
        to[k * plane + at] = signal[k];
        for (int o = 0; o < 3; o++) output[o] += signal[k] * response[k * 3 + o];
    }
    const float luminance = MORE(output[1], FAINTEST * FAINTEST), taken = block.most * best;
    maps[8 * at + 4] = taken;
    maps[8 * at + 5] = taken * WITHIN(output[0] / luminance, 0.0f, MAX_HUE);
    maps[8 * at + 6] = taken * WITHIN(output[2] / luminance, 0.0f, MAX_HUE);
}

// Position of a quad between two blocks along one axis.
typedef struct {
    int low, high;  // block before the quad, and next block
    float share;    // weight of the next block
} Between;

INLINE Between between(int pixel, int side, int blocks) {
    // The position is in half pixels and shifted by `side`, so that it is a positive integer.
    const int place = 2 * pixel + 2 + side, low = place / (2 * side) - 1;
    Between made = {WITHIN(low, 0, blocks - 1), WITHIN(low + 1, 0, blocks - 1), (float)(place % (2 * side)) / (2 * side)};
    return made;
}

INLINE float8 read_maps_at(Between down, Between across, __global const float8 *restrict maps, int block_columns) {
    __global const float8 *above = maps + (size_t)down.low * block_columns, *below = maps + (size_t)down.high * block_columns;
    const float8 left = above[across.low] + down.share * (below[across.low] - above[across.low]);
    const float8 right = above[across.high] + down.share * (below[across.high] - above[across.high]);
    return left + across.share * (right - left);
}

INLINE void store_maps(__global float *restrict to, size_t at, size_t quads, float8 made) {
    to[at] = made.s0;
    to[quads + at] = made.s1;
    to[2 * quads + at] = made.s2;
    to[3 * quads + at] = made.s3;
    to[4 * quads + at] = made.s4;
    to[5 * quads + at] = made.s5;
    to[6 * quads + at] = made.s6;
}
