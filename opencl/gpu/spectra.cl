// Graphics variant: smooths the spectra of a band (common/spectra.cl). Each work-item processes one pixel.

#define NEIGHBOURS (WINDOW * WINDOW)

INLINE float brightness_at(__global const float *made, size_t at, size_t stride) {
    float sum = 0.0f;
    for (int o = 0; o < OUTPUTS; o++) sum += made[o * stride + at];
    return sum * (1.0f / OUTPUTS);
}

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void smooth_spectra(__global const float *restrict made,   // (output, row of `made`, col)
                    __global float *restrict smoothed,     // (output, row, col)
                    float reach,
                    int made_rows, int top,                // number of rows in `made`, and index of its first row in the frame
                    int first, int frame_rows,             // index of the first row to write, and number of rows in the frame
                    int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows) return;
    const size_t stride = (size_t)made_rows * columns, pixels = (size_t)rows * columns, at = (size_t)y * columns + x;
    const size_t pixel = (size_t)(first + y - top) * columns + x;
    const float own = brightness_at(made, pixel, stride), inverse = inverse_of(own, reach);
    float weight[NEIGHBOURS], total = 0.0f, brighter = 0.0f;
    size_t place[NEIGHBOURS];
    for (int n = 0; n < NEIGHBOURS; n++) {
        const int row = mirrored(first + y + n / WINDOW - RADIUS, frame_rows) - top;
        place[n] = (size_t)row * columns + mirrored(x + n % WINDOW - RADIUS, columns);
        const float difference = brightness_at(made, place[n], stride) - own;
        weight[n] = nearness(difference, inverse);
        total += weight[n];
        brighter += weight[n] * difference;
    }
    const float share = 1.0f / total, ratio = brightness_ratio(own, brighter * share);
    for (int o = 0; o < OUTPUTS; o++) {
        __global const float *plane = made + o * stride;
        const float value = plane[pixel];
        float change = 0.0f;
        for (int n = 0; n < NEIGHBOURS; n++) change += weight[n] * (plane[place[n]] - value);
        smoothed[o * pixels + at] = own > DARKEST ? (value + change * share) * ratio : value;
    }
}
