// Processor variant: computes block means from the mosaic, block maps from the means, and quad maps from the block maps (common/clipping.cl). A
// work-item processes a tile of blocks or quads. Most parts of a frame are dark, textured or unclipped. Vector code finds these parts, and they
// are skipped.

#define EACH_OF_TILE \
    for (int y = GROUP_ROW; y < min(GROUP_ROW + BAND, rows); y++) \
        for (int x = GROUP_COLUMN; x < min(GROUP_COLUMN + TILE, columns); x += LANES)

// Whether any of `count` values is at least `bright`.
INLINE bool any_bright(const ushort *value, int count, int bright) {
    int p = 0;
    ints found = 0;
    for (; p + LANES <= count; p += LANES) found |= CONVERT(LOAD_PRIVATE(shorts, value + p), ints) >= bright;
    bool any = any_lane(found);
    AT_EDGE
    for (; p < count; p++) any = any || value[p] >= bright;
    return any;
}

// Measures a tile of blocks. `raw` contains the raw rows of a band from row `first` of the frame. Blocks outside the band are ignored.
COMPILED_ONCE measure_tile(int x0, int y0, __global const ushort *restrict raw, __global const uchar *restrict cfa,
                           __global float *restrict means, int bright, float black_level, float span, int phase_row,
                           int phase_column, int first, int raw_rows, int frame_rows, int frame_columns, int rows, int columns) {
    const int x1 = min(x0 + TILE, columns), begin = x0 * BLOCK_COLUMNS, width = min(TILE * BLOCK_COLUMNS, frame_columns - begin);
    const size_t plane = (size_t)rows * columns;
    ushort brightest[TILE * BLOCK_COLUMNS];  // highest value of each column
    for (int y = y0; y < min(y0 + BAND, rows); y++) {
        const Block row = block_at(y, x0, frame_rows, frame_columns);
        const bool inside = row.top >= first && row.bottom <= first + raw_rows;
        __global const ushort *start = raw + (ptrdiff_t)(row.top - first) * frame_columns + begin;
        int p = 0;
        for (; inside && p + LANES <= width; p += LANES) {
            shorts most = LOAD_GLOBAL(shorts, start + p);
            for (int r = 1; r < row.bottom - row.top; r++) {
                const shorts more = LOAD_GLOBAL(shorts, start + (size_t)r * frame_columns + p);
                most = more > most ? more : most;
            }
            STORE_PRIVATE(shorts, brightest + p) = most;
        }
        AT_EDGE
        for (; inside && p < width; p++) {
            brightest[p] = 0;
            for (int r = 0; r < row.bottom - row.top; r++) {
                const ushort value = start[(size_t)r * frame_columns + p];
                brightest[p] = MORE(brightest[p], value);
            }
        }
        for (int x = x0; x < x1; x += LANES) {
            const int end = min(x + LANES, x1), left = block_at(y, x, frame_rows, frame_columns).left;
            const int right = block_at(y, end - 1, frame_rows, frame_columns).right;
            if (left >= begin && (!inside || !any_bright(brightest + left - begin, right - left, bright))) {
                for (int k = 0; k < MEANS; k++) {
                    const floats dark = k < CHANNELS ? 0.0f : NO_RANGE;
                    STORE_FIRST(means + k * plane + (size_t)y * columns + x, dark, end - x);
                }
                continue;
            }
            for (int b = x; b < end; b++) {
                const Block block = block_at(y, b, frame_rows, frame_columns);
                int most = 0;
                if (inside && block.left < begin) most = brightest_of(block, raw, first, frame_columns);
                else if (inside)
                    for (int c = block.left; c < block.right; c++) most = MORE(most, brightest[c - begin]);
                float made[MEANS];
                NOT_COUNTED(made);
                if (min(most, MAX_RAW) >= bright)
                    measure_block(made, block, raw, cfa, black_level, span, phase_row, phase_column, first, frame_columns);
                for (int k = 0; k < MEANS; k++) means[k * plane + (size_t)y * columns + b] = made[k];
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
                         __global float *restrict uniformity, __global float *restrict estimates, int rows, int columns) {
    EACH_OF_TILE store_maps_of(y, x, means, response, maps, uniformity, estimates, rows, columns);
}

KERNEL_OF_ONE spread_estimates(__global const float *restrict means, __global const float *restrict response,
                               __global const float *restrict uniformity, __global const float *restrict from, __global float *restrict to,
                               __global float *restrict maps, int down, int across, int last, int rows,
                               int columns) {
    EACH_OF_TILE spread_at(y, x, means, response, uniformity, from, to, maps, down, across, last, rows, columns);
}

// Number of blocks in a row from which LANES quads are interpolated.
#define BLOCKS_ACROSS (2 * LANES / BLOCK_COLUMNS + 2)

// Whether any map of `count` blocks differs from zero.
INLINE bool any_map(__global const float8 *maps, __global const float *range, size_t block, int count) {
    float8 sum = 0.0f;
    for (int b = 0; b < count; b++)
        if (range[block + b] != NO_RANGE) sum += maps[block + b] * maps[block + b];
    const float4 sums = sum.lo + sum.hi;
    return sums.x + sums.y + sums.z + sums.w != 0.0f;
}

COMPILED_ONCE read_maps_of_tile(int x0, int y0, __global const float8 *restrict maps, __global const float *restrict means,
                                __global float *restrict to, int first, int block_rows, int block_columns, int plane_rows,
                                int plane_columns, int rows, int columns) {
    const size_t quads = QUADS_PLANE(plane_rows, plane_columns);
    __global uchar *flags = QUAD_FLAGS(to, plane_rows, plane_columns);
    __global const float *range = means + (size_t)CHANNELS * block_rows * block_columns;
    for (int y = y0; y < min(y0 + BAND, rows); y++) {
        const Between down = between(first + 2 * y, BLOCK_ROWS, block_rows);
        for (int x = x0; x < min(x0 + TILE, columns); x += LANES) {
            const int start = between(2 * x, BLOCK_COLUMNS, block_columns).low, count = min(BLOCKS_ACROSS, block_columns - start);
            const bool any = any_map(maps, range, (size_t)down.low * block_columns + start, count)
                          || any_map(maps, range, (size_t)down.high * block_columns + start, count);
            flags[QUAD_FLAG(y, x, plane_columns)] = any;
            for (int i = x; any && i < min(x + LANES, columns); i++)
                store_maps(to, (size_t)y * QUADS_STRIDE(plane_columns) + i, quads,
                           read_maps_at(down, between(2 * i, BLOCK_COLUMNS, block_columns), maps, range, block_columns));
        }
    }
}

KERNEL_OF_ONE read_maps(__global const float8 *restrict maps, __global const float *restrict means, __global float *restrict to, int first, int block_rows,
                        int block_columns, int plane_rows, int plane_columns, int rows, int columns) {
    read_maps_of_tile(GROUP_COLUMN, GROUP_ROW, maps, means, to, first, block_rows, block_columns, plane_rows, plane_columns, rows, columns);
}
