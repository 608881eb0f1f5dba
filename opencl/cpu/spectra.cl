// Processor variant: smooths the spectra of a band (common/spectra.cl).
//
// Each work-item processes one tile of TILE columns and BAND rows. A ring buffer contains the brightness of the latest rows, which many windows
// share. The weights of neighbours are computed once for all outputs.

#define REACHED (TILE + 2 * RADIUS)
#define NEIGHBOURS (WINDOW * WINDOW)

COMPILED_ONCE smooth_tile(int x0, int y0,
                          __global const float *restrict made,  // (output, row of `made`, col)
                          __global float *restrict smoothed,    // (output, row, col)
                          float reach,
                          int made_rows, int top,               // number of rows in `made`, and index of its first row in the frame
                          int first, int frame_rows,            // index of the first row to write, and number of rows in the frame
                          int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const size_t stride = (size_t)made_rows * columns, pixels = (size_t)rows * columns;
    float brightness[WINDOW][REACHED + LANES];
    for (int next = y0 - RADIUS; next < y1 + RADIUS; next++) {
        __global const float *entering = made + (size_t)(mirrored(first + next, frame_rows) - top) * columns;
        float *ring = brightness[(next - y0 + RADIUS) % WINDOW];
        for (int p = 0; p < width + 2 * RADIUS; p += LANES) {
            floats sum = 0.0f;
            for (int o = 0; o < OUTPUTS; o++) sum += read_across(entering + o * stride, x0 - RADIUS + p, columns);
            STORE_PRIVATE(floats, ring + p) = sum * (1.0f / OUTPUTS);
        }
        const int y = next - RADIUS;
        if (y < y0) continue;
        __global const float *row[WINDOW];
        for (int j = 0; j < WINDOW; j++)
            row[j] = made + (size_t)(mirrored(first + y + j - RADIUS, frame_rows) - top) * columns;
        for (int x = 0; x < width; x += LANES) {
            const floats own = LOAD_PRIVATE(floats, brightness[(y - y0 + RADIUS) % WINDOW] + x + RADIUS);
            const floats inverse = inverse_of(own, reach);
            floats weight[NEIGHBOURS], total = 0.0f, brighter = 0.0f;
            #pragma unroll
            for (int n = 0; n < NEIGHBOURS; n++) {
                const floats there = LOAD_PRIVATE(floats, brightness[(y - y0 + n / WINDOW) % WINDOW] + x + n % WINDOW);
                weight[n] = nearness(there - own, inverse);
                total += weight[n];
                brighter += weight[n] * (there - own);
            }
            const floats share = 1.0f / total, ratio = brightness_ratio(own, brighter * share);
            const int inside = x0 + x >= RADIUS && x0 + x + LANES + RADIUS <= columns;
            for (int o = 0; o < OUTPUTS; o++) {
                const size_t plane = o * stride;
                const floats value = read_across(row[RADIUS] + plane, x0 + x, columns);
                floats change = 0.0f;
                if (inside) {
                    #pragma unroll
                    for (int n = 0; n < NEIGHBOURS; n++)
                        change += weight[n] * (LOAD_GLOBAL(floats, row[n / WINDOW] + plane + x0 + x + n % WINDOW - RADIUS) - value);
                } else
                    for (int n = 0; n < NEIGHBOURS; n++)
                        change += weight[n] * (read_across(row[n / WINDOW] + plane, x0 + x + n % WINDOW - RADIUS, columns) - value);
                const floats mean = value + change * share, result = own > DARKEST ? mean * ratio : value;
                __global float *to = smoothed + o * pixels + (size_t)y * columns + x0 + x;
                if (width - x >= LANES) STORE_GLOBAL(floats, to) = result;
                else WRITE_FIRST(float, floats, to, result, width - x);
            }
        }
    }
}

KERNEL_OF_ONE smooth_spectra(__global const float *restrict made, __global float *restrict smoothed, float reach, int made_rows,
                             int top, int first, int frame_rows, int rows, int columns) {
    smooth_tile(GROUP_COLUMN, GROUP_ROW, made, smoothed, reach, made_rows, top, first, frame_rows, rows, columns);
}
