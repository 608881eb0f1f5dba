// Padded mosaic → class of every pixel. The formulas are those of l3cli/classify.py, in uint: exact, or wrapping to exact.
//
// One work-item labels TILE columns × `band` rows. Sums and squares of each channel down the PATCH rows of a column slide
// from row to row: the entering row is added, the leaving one subtracted. Across columns they are added up anew, which
// costs less than it looks because 16 pixels go side by side. No branch depends on a pixel.
//
// Buffers with a `period` axis repeat a row of the CFA until 16 pixels can be read from any phase on.

#define SPAN ((TILE + 2 * RADIUS + 15) / 16 * 16)  // columns that a tile looks at
#define PERIOD (CFA_COLUMNS + 15)                  // length of the period axis
#define SPREAD (2 * SATURATION_RADIUS + 1)          // rows and columns in which saturation counts

INLINE uint16 read_values(__global const ushort *p) {
    return __builtin_convertvector(*(__global const ushort16_unaligned *)p, uint16);
}
INLINE uint16 read_period(__global const uint *p) { return *(__global const uint16_unaligned *)p; }
INLINE uint16 read_sums(const uint *p) { return *(const uint16_unaligned *)p; }
INLINE void add_sums(uint *p, uint16 v) { *(uint16_unaligned *)p += v; }

// Phase within the CFA of padded row or column p, whose frame begins at phase `start`.
#define PADDED_PHASE(p, start, period) (((p) + (start) + ((period) - 1) * RADIUS) % (period))

// Let row `entering` into the running sums and, where `full` has its bits set, row `leaving` out of them.
INLINE void slide(uint sums[CHANNELS][SPAN], uint squares[CHANNELS][SPAN],
                  __global const ushort *entering, __global const uint *entering_member,
                  __global const ushort *leaving, __global const uint *leaving_member, uint full, int phase) {
    for (int x = 0; x < SPAN; x += 16, phase = (phase + 16) % CFA_COLUMNS) {
        const uint16 entered = read_values(entering + x) >> SHIFT, left = (read_values(leaving + x) >> SHIFT) & full;
        const uint16 entered_square = entered * entered, left_square = left * left;
        #pragma unroll
        for (int c = 0; c < CHANNELS; c++) {
            const int member = c * CFA_ROWS * PERIOD + phase;
            const uint16 in = read_period(entering_member + member), out = read_period(leaving_member + member);
            add_sums(sums[c] + x, (entered & in) - (left & out));
            add_sums(squares[c] + x, (entered_square & in) - (left_square & out));
        }
    }
}

// Channels that are saturated anywhere down the SPREAD rows from `top` on, one bit a channel, for each column of the tile.
INLINE void saturated_columns(uint saturated[SPAN], __global const ushort *top, int stride,
                              __global const uint *channel_bit, int row_phase, int phase) {
    for (int x = 0; x < SPAN; x += 16, phase = (phase + 16) % CFA_COLUMNS) {
        uint16 found = 0;
        for (int j = 0; j < SPREAD; j++) {
            const uint16 bit = read_period(channel_bit + (row_phase + j) % CFA_ROWS * PERIOD + phase);
            found |= as_uint16(read_values(top + j * stride + x) >= SATURATION) & bit;
        }
        *(uint16_unaligned *)(saturated + x) = found;
    }
}

INLINE uint16 box_sum(const uint *columns, int size) {
    uint16 total = read_sums(columns);
    #pragma unroll
    for (int j = 1; j < size; j++) total += read_sums(columns + j);
    return total;
}

// Level and contrast of 16 pixels as level * CONTRASTS + contrast. Comparing with every edge needs no look-up.
INLINE uint16 decide(uint16 level_sum, uint16 variance_sum,
                     __global const uint *level_edges, __global const uint *contrast_edges) {
    uint16 level = 0, contrast = 0, edge[CONTRASTS];
    for (int k = 0; k < CONTRASTS - 1; k++) edge[k] = contrast_edges[k * LEVELS];
    for (int l = 1; l < LEVELS; l++) {
        const int16 reached = level_sum >= level_edges[l - 1];
        level -= as_uint16(reached);
        for (int k = 0; k < CONTRASTS - 1; k++) edge[k] = reached ? (uint16)contrast_edges[k * LEVELS + l] : edge[k];
    }
    for (int k = 0; k < CONTRASTS - 1; k++) contrast -= as_uint16(variance_sum > edge[k]);
    return level * CONTRASTS + contrast;
}

// The chroma of the lowest score, the first of equals.
INLINE uint16 lowest(const int16 score[CHROMAS]) {
    int16 least = score[0];
    uint16 chroma = 0;
    for (int k = 1; k < CHROMAS; k++) {
        const int16 lower = score[k] < least;
        least = lower ? score[k] : least;
        chroma = lower ? (uint16)k : chroma;
    }
    return chroma;
}

__kernel void classes(__global const ushort *restrict padded,             // (padded row, stride) DN
                      __global const uint *restrict member,               // (channel, CFA row, period) all bits or none
                      __global const uint *restrict channel_bit,          // (CFA row, period) 1 << channel
                      __global const uint *restrict count,                // (channel, CFA row, period) taps of the channel
                      __global const uint *restrict mean_reciprocal,      // (channel, CFA row, period) round(65536 / count)
                      __global const uint *restrict variance_reciprocal,  // (channel, CFA row, period) round(512 / count)
                      __global const uint *restrict site_column,          // (period) CFA column
                      __global const uint *restrict level_edges,          // (level edge)
                      __global const uint *restrict contrast_edges,       // (contrast edge, level)
                      __global const ushort *restrict case_of_code,       // (code)
                      __global const int *restrict chroma_weights,        // (chroma, channel)
                      __global uint *restrict labels,                     // (row, col)
                      int rows, int columns, int stride, int phase_row, int phase_column, int band) {
    const int x0 = get_global_id(0) * TILE, y0 = get_global_id(1) * band;
    const int y1 = min(y0 + band, rows), width = min(TILE, columns - x0);
    const int padded_phase = PADDED_PHASE(x0, phase_column, CFA_COLUMNS);
    uint sums[CHANNELS][SPAN], squares[CHANNELS][SPAN], saturated[SPAN];
    for (int c = 0; c < CHANNELS; c++)
        for (int x = 0; x < SPAN; x++) sums[c][x] = squares[c][x] = 0;
    __global const ushort *tile = padded + x0;
    for (int bottom = y0; bottom < y1 + 2 * RADIUS; bottom++) {
        const uint full = bottom >= y0 + PATCH ? 0xffffffffu : 0;
        const int top = full ? bottom - PATCH : bottom;
        slide(sums, squares,
              tile + (size_t)bottom * stride, member + PADDED_PHASE(bottom, phase_row, CFA_ROWS) * PERIOD,
              tile + (size_t)top * stride, member + PADDED_PHASE(top, phase_row, CFA_ROWS) * PERIOD, full, padded_phase);
        if (bottom < y0 + 2 * RADIUS) continue;
        const int y = bottom - 2 * RADIUS, near = y + RADIUS - SATURATION_RADIUS, site_row = (y + phase_row) % CFA_ROWS;
        saturated_columns(saturated, tile + (size_t)near * stride, stride, channel_bit,
                          PADDED_PHASE(near, phase_row, CFA_ROWS), padded_phase);
        __global uint *label_row = labels + (size_t)y * columns + x0;
        for (int x = 0; x < width; x += 16) {
            const int phase = (x0 + x + phase_column) % CFA_COLUMNS;
            uint16 level_sum = 0, variance_sum = 0;
            int16 score[CHROMAS];
            for (int k = 0; k < CHROMAS; k++) score[k] = 0;
            #pragma unroll
            for (int c = 0; c < CHANNELS; c++) {
                const int at = (c * CFA_ROWS + site_row) * PERIOD + phase;
                const uint16 sum = box_sum(sums[c] + x, PATCH), square = box_sum(squares[c] + x, PATCH);
                const uint16 scaled = sum * read_period(mean_reciprocal + at), mean = scaled >> 16;
                const uint16 deviation = square - mean * (sum + sum - mean * read_period(count + at));
                const uint16 variance = deviation * read_period(variance_reciprocal + at), cap = 0xffffffffu / CHANNELS;
                level_sum += scaled >> (16 - LEVEL_FRACTION);
                variance_sum += variance > cap ? cap : variance;
                const int16 above_black = as_int16(scaled >> (16 - CHROMA_FRACTION)) - CHROMA_BLACK;
                const int16 signal = above_black > 0 ? above_black : (int16)0;
                #pragma unroll
                for (int k = 0; k < CHROMAS; k++) score[k] += signal * chroma_weights[k * CHANNELS + c];
            }
            const uint16 decided = decide(level_sum, variance_sum, level_edges, contrast_edges);
            const uint16 site = read_period(site_column + phase) + site_row * CFA_COLUMNS;
            const uint16 first_kind = (site * LEVELS * CONTRASTS + decided) * KINDS;
            uint16 code = 0;
            for (int j = 0; j < SPREAD; j++) code |= read_sums(saturated + x + RADIUS - SATURATION_RADIUS + j);
            uint pixel[16], pattern[16], chroma[16];
            *(uint16_unaligned *)pixel = first_kind;
            *(uint16_unaligned *)chroma = lowest(score);
            *(uint16_unaligned *)pattern = code;
            const int inside = min(16, width - x);
            for (int i = 0; i < inside; i++) {
                const uint saturation = case_of_code[pattern[i]];
                label_row[x + i] = pixel[i] + (saturation ? CHROMAS - 1 + saturation : chroma[i]);
            }
        }
    }
}
