// Graphics variant: smooths the chroma of a band, and encodes the result (common/smoothed_chroma.cl). Each work-item processes one pixel.

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void smooth_chroma(__global const float *restrict made,    // (output, row of `made`, col)
                   __global const float *restrict matrix,  // (3, 3) from XYZ to linear picture values
                   __global CODE *restrict picture,        // (row, col, 3), or (output, row, col)
#ifdef SHADED
                   __global const float *restrict gain,    // (row of `made`, node) shading gains of the outputs, every GAIN_STEP columns
#endif
                   LEAST_PARAMETERS
                   float by_luminance, float by_x, float by_z,
                   int made_rows, int top,                 // number of rows in `made`, and index of its first row in the frame
                   int first, int frame_rows,              // index of the first row to write, and number of rows in the frame
                   int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows) return;
    const size_t stride = (size_t)made_rows * columns, at = (size_t)y * columns + x;
    const size_t pixel = (size_t)(first + y - top) * columns + x;
    float own[3], sums[3] = {0.0f, 0.0f, 0.0f}, diagonal[3] = {0.0f, 0.0f, 0.0f}, there[3];
    for (int o = 0; o < 3; o++) own[o] = made[o * stride + pixel];
    const int down[] = {CHROMA_ROWS}, right[] = {CHROMA_COLUMNS};
    size_t place[NEIGHBOURS];
    float differences = 0.0f;
    for (int n = 0; n < NEIGHBOURS; n++) {
        place[n] = (size_t)(mirrored(first + y + down[n], frame_rows) - top) * columns + mirrored(x + right[n], columns);
        if (n < NEAR_NEIGHBOURS) differences += difference_between(own[1], made[stride + place[n]]);
    }
    const Scaled scaled = scaled_pixel(own, differences, by_luminance, by_x, by_z);
    for (int n = 0; n < NEIGHBOURS; n++) {
        for (int o = 0; o < 3; o++) there[o] = made[o * stride + place[n]];
        add_neighbour(sums, scaled, there, UNLIKE(n));
        for (int o = 0; o < 3 && n < 4; o++) diagonal[o] += there[o];
    }
    change_chroma(own, scaled, sums, by_x, by_z);
#ifdef LEAST_REACH
    float smallest = INFINITY, factor = 1.0f;
    for (int i = max(first + y - LEAST_REACH, 0); i <= min(first + y + LEAST_REACH, frame_rows - 1); i++)
        for (int j = max(x - LEAST_REACH, 0); j <= min(x + LEAST_REACH, columns - 1); j++) {
            const float of_white = scale[(i + phase_row) % CFA_ROWS * SCALE_PERIOD + (j + phase_column) % CFA_COLUMNS];
            smallest = min(smallest, (min(raw[(size_t)(i - raw_first) * columns + j], (ushort)MAX_RAW) - black_level) * of_white);
        }
#ifdef SHADED
    __global const float *node = gain + (size_t)(first + y - top) * GAIN_NODES(columns) + x / GAIN_STEP;
    factor = node[0] + (node[1] - node[0]) * ((x % GAIN_STEP) * (1.0f / GAIN_STEP));
#endif
    raise_luminance(own, diagonal, factor * least_luminance(smallest));
#endif
#ifdef PLANES
    for (int o = 0; o < 3; o++) picture[o * (size_t)rows * columns + at] = own[o];
#else
    float linear[3];
    for (int p = 0; p < 3; p++) linear[p] = matrix[3 * p] * own[0] + matrix[3 * p + 1] * own[1] + matrix[3 * p + 2] * own[2];
    into_gamut(linear);
    for (int p = 0; p < 3; p++) picture[3 * at + p] = (CODE)encode(linear[p]);
#endif
}
