// Graphics variant: computes block means from the mosaic, block maps from the means, and quad maps from the block maps (common/clipping.cl).
// Each work-item processes one block or one quad.

#define KERNEL_OF_TILE __kernel __attribute__((reqd_work_group_size(TILE, BAND, 1))) void
#define ITS_PLACE \
    const int x = get_global_id(0), y = get_global_id(1); \
    if (x >= columns || y >= rows) return

// Measures a block. `raw` contains the raw rows of a band from row `first` of the frame. Blocks outside the band are ignored.
KERNEL_OF_TILE measure_blocks(__global const ushort *restrict raw, __global const uchar *restrict cfa, __global float *restrict means,
                              int bright, float black_level, float span, int phase_row, int phase_column, int first, int raw_rows,
                              int frame_rows, int frame_columns, int rows, int columns) {
    ITS_PLACE;
    const Block block = block_at(y, x, frame_rows, frame_columns);
    float made[MEANS];
    NOT_COUNTED(made);
    if (block.top >= first && block.bottom <= first + raw_rows
        && min(brightest_of(block, raw, first, frame_columns), MAX_RAW) >= bright)
        measure_block(made, block, raw, cfa, black_level, span, phase_row, phase_column, first, frame_columns);
    for (int k = 0; k < MEANS; k++) means[((size_t)k * rows + y) * columns + x] = made[k];
}

KERNEL_OF_TILE map_blocks(__global const float *restrict means, __global const float *restrict response,
                          __global float *restrict maps, __global float *restrict uniformity, __global float *restrict estimates,
                          __global float *restrict others, __global uchar *restrict flags, int rows, int columns) {
    ITS_PLACE;
    store_maps_of(y, x, means, response, maps, uniformity, estimates, others, flags, rows, columns);
}

KERNEL_OF_TILE spread_estimates(__global const float *restrict means, __global const float *restrict response,
                                __global const float *restrict uniformity, __global const float *restrict from,
                                __global float *restrict to, __global float *restrict maps, __global const uchar *restrict flags,
                                int down, int across, int last, int rows, int columns) {
    ITS_PLACE;
    spread_at(y, x, means, response, uniformity, from, to, maps, flags, down, across, last, rows, columns);
}

KERNEL_OF_TILE read_maps(__global const float8 *restrict maps, __global const uchar *restrict flags, __global float *restrict to,
                         int first, int block_rows, int block_columns, int plane_rows, int plane_columns, int rows, int columns) {
    ITS_PLACE;
    const Between down = between(first + 2 * y, BLOCK_ROWS, block_rows), across = between(2 * x, BLOCK_COLUMNS, block_columns);
    const float8 left = maps_between_rows(down, maps, flags, across.low, block_columns);
    const float8 right = maps_between_rows(down, maps, flags, across.high, block_columns);
    store_maps(QUAD_MAPS(to, y, x, plane_columns), left + across.share * (right - left));
}
