// Graphics variant: encodes the outputs X, Y, Z of a frame. The picture is the same as the one that the kernel `transform` writes (see
// cpu/encode.cl). Each work-item processes one pixel.

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void encode_1(__global const float *restrict outputs,  // (output, row, col)
              __global const float *restrict matrix,   // (3, 3) from XYZ to linear picture values
              __global CODE *restrict picture,         // (row, col, 3)
              int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows) return;
    const size_t at = (size_t)y * columns + x, pixels = (size_t)rows * columns;
    const float X = outputs[at], Y = outputs[pixels + at], Z = outputs[2 * pixels + at];
    float linear[3];
    for (int p = 0; p < 3; p++) linear[p] = matrix[3 * p] * X + matrix[3 * p + 1] * Y + matrix[3 * p + 2] * Z;
    into_gamut(linear);
    for (int p = 0; p < 3; p++) picture[3 * at + p] = (CODE)encode(linear[p]);
}
