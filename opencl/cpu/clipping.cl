// Processor variant: computes block means from the mosaic, block maps from the means, and quad maps from the block maps (common/clipping.cl). Each
// work-item processes one tile of blocks or quads. Most parts of a frame are dark, textured or unclipped. Vector code finds these parts, and they
// are skipped.

#define EACH_OF_TILE \
    for (int y = GROUP_ROW; y < min(GROUP_ROW + BAND, rows); y++) \
        for (int x = GROUP_COLUMN; x < min(GROUP_COLUMN + TILE, columns); x += LANES)

// Whether any raw value in a range of rows and columns is at least `bright`.
INLINE bool any_bright(__global const ushort *restrict raw, Block range, int bright, int first, int frame_columns) {
    shorts most = 0;
    int rest = 0;
    for (int r = range.top; r < range.bottom; r++) {
        __global const ushort *row = raw + (ptrdiff_t)(r - first) * frame_columns;
        int c = range.left;
        for (; c + LANES <= range.right; c += LANES) {
            const shorts value = LOAD_GLOBAL(shorts, row + c);
            most = value > most ? value : most;
        }
        AT_EDGE
        for (; c < range.right; c++) rest = MORE(rest, row[c]);
    }
    return rest >= bright || any_lane(CONVERT(most, ints) >= bright);
}

// Channel of each pixel of a block, and number of pixels per channel. They are the same for all blocks whose columns begin a CFA period.
typedef struct {
    int channel[BLOCK_ROWS][BLOCK_COLUMNS], count[CHANNELS];
} Pattern;

INLINE Pattern pattern_at(__global const uchar *restrict cfa, int row, int column) {
    Pattern made;
    for (int k = 0; k < CHANNELS; k++) made.count[k] = 0;
    for (int r = 0; r < BLOCK_ROWS; r++)
        for (int c = 0; c < BLOCK_COLUMNS; c++) {
            made.channel[r][c] = cfa[(row + r) % CFA_ROWS * CFA_COLUMNS + (column + c) % CFA_COLUMNS];
            made.count[made.channel[r][c]]++;
        }
    return made;
}

// Does the same as measure_block, for LANES adjacent blocks with the first pixel `raw`.
INLINE void measure_blocks_in_lanes(floats made[MEANS], const Pattern *pattern, __global const ushort *restrict raw, int bright,
                                    float black_level, float span, int frame_columns) {
    ints sum[CHANNELS], lowest[CHANNELS], highest[CHANNELS], brightest = 0, widest = 0;
    for (int k = 0; k < CHANNELS; k++) {
        sum[k] = highest[k] = 0;
        lowest[k] = MAX_RAW;
    }
    for (int r = 0; r < BLOCK_ROWS; r++) {
        ushort lane[BLOCK_COLUMNS][LANES];
        for (int i = 0; i < LANES; i++)
            #pragma unroll
            for (int c = 0; c < BLOCK_COLUMNS; c++) lane[c][i] = raw[(size_t)r * frame_columns + i * BLOCK_COLUMNS + c];
        for (int c = 0; c < BLOCK_COLUMNS; c++) {
            const ints read = CONVERT(LOAD_PRIVATE(shorts, lane[c]), ints), value = read < MAX_RAW ? read : MAX_RAW;
            const int k = pattern->channel[r][c];
            sum[k] += value;
            lowest[k] = value < lowest[k] ? value : lowest[k];
            highest[k] = value > highest[k] ? value : highest[k];
        }
    }
    bool whole = true;
    for (int k = 0; k < CHANNELS; k++) {
        const ints range = highest[k] - lowest[k];
        whole = whole && pattern->count[k] > 0;
        brightest = highest[k] > brightest ? highest[k] : brightest;
        widest = range > widest ? range : widest;
    }
    const ints counted = whole ? brightest >= bright : (ints)0;
    for (int k = 0; k < CHANNELS; k++) {
        const floats mean = (CONVERT(sum[k], floats) / (float)MORE(pattern->count[k], 1) - black_level) / span;
        made[k] = counted ? less_of(mean, 1.0f) : (floats)0.0f;
    }
    made[CHANNELS] = counted ? CONVERT(widest, floats) / span : (floats)NO_RANGE;
}

// Measures a tile of blocks. `raw` contains the raw rows of a band from row `first` of the frame. Blocks outside the band are ignored.
COMPILED_ONCE measure_tile(int x0, int y0, __global const ushort *restrict raw, __global const uchar *restrict cfa,
                           __global float *restrict means, int bright, float black_level, float span, int phase_row,
                           int phase_column, int first, int raw_rows, int frame_rows, int frame_columns, int rows, int columns) {
    const int x1 = min(x0 + TILE, columns);
    const size_t plane = (size_t)rows * columns;
    for (int y = y0; y < min(y0 + BAND, rows); y++) {
        const Pattern pattern = pattern_at(cfa, block_at(y, x0, frame_rows, frame_columns).top + phase_row, phase_column);
        for (int x = x0; x < x1; x += LANES) {
            const int end = min(x + LANES, x1);
            __global float *to = means + (size_t)y * columns;
            Block range = block_at(y, x, frame_rows, frame_columns);
            range.right = block_at(y, end - 1, frame_rows, frame_columns).right;
            if (range.top < first || range.bottom > first + raw_rows || !any_bright(raw, range, bright, first, frame_columns)) {
                for (int k = 0; k < MEANS; k++) STORE_FIRST(to + k * plane + x, (floats)(k < CHANNELS ? 0.0f : NO_RANGE), end - x);
                continue;
            }
            if (range.right == (x + LANES) * BLOCK_COLUMNS && range.bottom == range.top + BLOCK_ROWS) {
                floats made[MEANS];
                __global const ushort *corner = raw + (size_t)(range.top - first) * frame_columns + range.left;
                measure_blocks_in_lanes(made, &pattern, corner, bright, black_level, span, frame_columns);
                for (int k = 0; k < MEANS; k++) STORE_GLOBAL(floats, to + k * plane + x) = made[k];
                continue;
            }
            for (int b = x; b < end; b++) {  // blocks at the right edge, or of a low frame
                const Block block = block_at(y, b, frame_rows, frame_columns);
                float made[MEANS];
                NOT_COUNTED(made);
                if (min(brightest_of(block, raw, first, frame_columns), MAX_RAW) >= bright)
                    measure_block(made, block, raw, cfa, black_level, span, phase_row, phase_column, first, frame_columns);
                for (int k = 0; k < MEANS; k++) to[k * plane + b] = made[k];
            }
        }
    }
}

KERNEL_OF_ONE measure_blocks(__global const ushort *restrict raw, __global const uchar *restrict cfa, __global float *restrict means,
                             int bright, float black_level, float span, int phase_row, int phase_column, int first, int raw_rows,
                             int frame_rows, int frame_columns, int rows, int columns) {
    measure_tile(GROUP_COLUMN, GROUP_ROW, raw, cfa, means, bright, black_level, span, phase_row, phase_column, first, raw_rows,
                 frame_rows, frame_columns, rows, columns);
}

KERNEL_OF_ONE map_blocks(__global const float *restrict means, __global const float *restrict response, __global float *restrict maps,
                         __global float *restrict uniformity, __global float *restrict estimates, __global float *restrict others,
                         __global uchar *restrict flags, int rows, int columns) {
    EACH_OF_TILE store_maps_of(y, x, means, response, maps, uniformity, estimates, others, flags, rows, columns);
}

KERNEL_OF_ONE spread_estimates(__global const float *restrict means, __global const float *restrict response,
                               __global const float *restrict uniformity, __global const float *restrict from, __global float *restrict to,
                               __global float *restrict maps, __global const uchar *restrict flags, int down, int across, int last, int rows,
                               int columns) {
    EACH_OF_TILE spread_at(y, x, means, response, uniformity, from, to, maps, flags, down, across, last, rows, columns);
}

// Largest number of blocks in a row between which LANES quads are interpolated.
#define MOST_BLOCKS ((4 * (LANES - 1) + 2 * BLOCK_COLUMNS - 1) / (2 * BLOCK_COLUMNS) + 2)

// Whether any block from column `low` to column `high` of a row has maps.
INLINE bool any_maps(__global const uchar *flags, int y, int low, int high, int columns) {
    bool any = false;
    for (size_t group = GROUP_OF(y, low, columns); group <= GROUP_OF(y, high, columns); group++) any = any || flags[group];
    return any;
}

COMPILED_ONCE read_maps_of_tile(int x0, int y0, __global const float8 *restrict maps, __global const uchar *restrict flags,
                                __global float *restrict to, int first, int block_rows, int block_columns, int plane_rows,
                                int plane_columns, int rows, int columns) {
    __global uchar *quad_flags = QUAD_FLAGS(to, plane_rows, plane_columns);
    for (int y = y0; y < min(y0 + BAND, rows); y++) {
        const Between down = between(first + 2 * y, BLOCK_ROWS, block_rows);
        for (int x = x0; x < min(x0 + TILE, columns); x += LANES) {
            const int end = min(x + LANES, columns), low = between(2 * x, BLOCK_COLUMNS, block_columns).low;
            const int high = between(2 * (end - 1), BLOCK_COLUMNS, block_columns).high;
            const bool any = any_maps(flags, down.low, low, high, block_columns) || any_maps(flags, down.high, low, high, block_columns);
            quad_flags[QUAD_GROUP(y, x, plane_columns)] = any;
            if (!any) continue;
            float8 block[MOST_BLOCKS];
            for (int b = low; b <= high; b++) block[b - low] = maps_between_rows(down, maps, flags, b, block_columns);
            for (int i = x; i < end; i++) {
                const Between across = between(2 * i, BLOCK_COLUMNS, block_columns);
                const float8 left = block[across.low - low], right = block[across.high - low];
                store_maps(QUAD_MAPS(to, y, i, plane_columns), left + across.share * (right - left));
            }
        }
    }
}

KERNEL_OF_ONE read_maps(__global const float8 *restrict maps, __global const uchar *restrict flags, __global float *restrict to, int first,
                        int block_rows, int block_columns, int plane_rows, int plane_columns, int rows, int columns) {
    read_maps_of_tile(GROUP_COLUMN, GROUP_ROW, maps, flags, to, first, block_rows, block_columns, plane_rows, plane_columns, rows, columns);
}
