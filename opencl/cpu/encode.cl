// Processor variant: encodes the outputs X, Y, Z of a frame. The picture is the same as the one that the kernel `transform` writes. This kernel is
// used if the exposure is computed from the outputs. The host reads LANES from the kernel's name.
//
// Each work-item processes one tile of TILE columns and BAND rows.

#if LANES == 16
#define ENCODE encode_16
#else
#define ENCODE encode_8
#endif

// Reads LANES pixels, or the first `count` if there are fewer.
INLINE floats read_pixels(__global const float *from, int count) {
    if (count >= LANES) return LOAD_GLOBAL(floats, from);
    float pixel[LANES] = {0};
    AT_EDGE
    for (int i = 0; i < count; i++) pixel[i] = from[i];
    return LOAD_PRIVATE(floats, pixel);
}

COMPILED_ONCE encode_tile(int x0, int y0,
                          __global const float *restrict outputs,  // (output, row, col)
                          __global const float *restrict matrix,   // (3, 3) from XYZ to linear picture values
                          __global CODE *restrict picture,         // (row, col, 3)
                          int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const size_t pixels = (size_t)rows * columns;
    for (int y = y0; y < y1; y++)
        for (int x = 0; x < width; x += LANES) {
            const size_t at = (size_t)y * columns + x0 + x;
            floats made[3];
            #pragma unroll
            for (int o = 0; o < 3; o++) made[o] = read_pixels(outputs + o * pixels + at, width - x);
            write_pixels(picture, made, matrix, at, width - x, pixels);
        }
}

KERNEL_OF_ONE ENCODE(__global const float *restrict outputs, __global const float *restrict matrix, __global CODE *restrict picture,
                     int rows, int columns) {
    encode_tile(GROUP_COLUMN, GROUP_ROW, outputs, matrix, picture, rows, columns);
}
