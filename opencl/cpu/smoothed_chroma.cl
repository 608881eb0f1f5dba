// Processor variant: smooths the chroma of X, Y and Z in a band of rows, and encodes the result (common/smoothed_chroma.cl).
//
// A work-item processes a tile of TILE columns and BAND rows.

// Reads LANES values of X, Y and Z, starting at column x. If `inside` is false, columns outside the frame are mirrored.
INLINE void read_three(floats *value, __global const float *row, size_t stride, int x, int columns, bool inside) {
    #pragma unroll
    for (int o = 0; o < 3; o++) value[o] = inside ? LOAD_GLOBAL(floats, row + o * stride + x) : read_across(row + o * stride, x, columns);
}

INLINE void smooth_pixels(floats *own, __global const float *const *row, size_t stride, int x, int columns, bool inside,
                          float by_luminance, float by_x, float by_z) {
    floats sums[3] = {0.0f, 0.0f, 0.0f}, there[3];
    read_three(own, row[2], stride, x, columns, inside);
    const Factors by = factors_of(own[1], by_luminance, by_x, by_z);
    #pragma unroll
    for (int n = 0; n < 8; n++) {
        const int line[] = {1, 1, 3, 3, 0, 4, 2, 2}, right[] = {-1, 1, -1, 1, 0, 0, -CHROMA_REACH, CHROMA_REACH};
        read_three(there, row[line[n]], stride, x + right[n], columns, inside);
        add_neighbour(sums, own, there, by);
    }
    change_chroma(own, sums);
}

COMPILED_ONCE smooth_chroma_tile(int x0, int y0,
                                 __global const float *restrict made,    // (output, made row, col)
                                 __global const float *restrict matrix,  // (3, 3) from X, Y, Z to linear picture values
                                 __global CODE *restrict picture,        // (row, col, 3), or (output, row, col)
                                 float by_luminance, float by_x, float by_z,
                                 int made_rows, int top,                 // number of rows in `made`, and row of the frame where they begin
                                 int first, int frame_rows,              // row of the frame where the written rows begin, and rows of the frame
                                 int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const size_t stride = (size_t)made_rows * columns, pixels = (size_t)rows * columns;
    for (int y = y0; y < y1; y++) {
        __global const float *row[5];
        const int down[] = {-CHROMA_REACH, -1, 0, 1, CHROMA_REACH};
        #pragma unroll
        for (int n = 0; n < 5; n++) row[n] = made + (size_t)(mirrored(first + y + down[n], frame_rows) - top) * columns;
        for (int x = 0; x < width; x += LANES) {
            floats own[3];
            const int column = x0 + x;
            if (column >= CHROMA_REACH && column + LANES + CHROMA_REACH <= columns)
                smooth_pixels(own, row, stride, column, columns, true, by_luminance, by_x, by_z);
            else
                smooth_pixels(own, row, stride, column, columns, false, by_luminance, by_x, by_z);
            write_pixels(picture, own, matrix, (size_t)y * columns + column, width - x, pixels);
        }
    }
}

KERNEL_OF_ONE smooth_chroma(__global const float *restrict made, __global const float *restrict matrix, __global CODE *restrict picture,
                            float by_luminance, float by_x, float by_z, int made_rows, int top, int first, int frame_rows, int rows,
                            int columns) {
    smooth_chroma_tile(GROUP_COLUMN, GROUP_ROW, made, matrix, picture, by_luminance, by_x, by_z, made_rows, top, first, frame_rows, rows,
                       columns);
}
