// Processor variant: planes → their means; means → those after an edge-avoiding step. One work-item takes a tile of means.

// The sums of BIN neighbours in LANES * BIN values of a row; BIN is 4.
INLINE ints sums_of_four(const int *from) {
    ints pair[2];
    #pragma unroll
    for (int i = 0; i < 2; i++) {
        const ints a = LOAD_PRIVATE(ints, from + 2 * i * LANES), b = LOAD_PRIVATE(ints, from + (2 * i + 1) * LANES);
        pair[i] = __builtin_shufflevector(a, b, ALL_LANES(EVEN)) + __builtin_shufflevector(a, b, ALL_LANES(ODD));
    }
    return __builtin_shufflevector(pair[0], pair[1], ALL_LANES(EVEN)) + __builtin_shufflevector(pair[0], pair[1], ALL_LANES(ODD));
}

COMPILED_ONCE bin_tile(int x0, int y0, __global const int *restrict planes, __global float *restrict means, int plane_rows,
                       int plane_columns, int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0), pixels = min(TILE * BIN, plane_columns - x0 * BIN);
    const int stride = MEANS_STRIDE(plane_columns);
    int sum[TILE * BIN + 4 * LANES];
    for (int i = 0; i < TILE * BIN + 4 * LANES; i++) sum[i] = 0;
    for (int s = 0; s < 3; s++)
        for (int y = y0; y < y1; y++) {
            const int height = min(BIN, plane_rows - y * BIN);
            __global const int *from = planes + ((size_t)s * plane_rows + y * BIN) * plane_columns + x0 * BIN;
            int p = 0;
            for (; p + LANES <= pixels; p += LANES) {
                ints total = 0;
                for (int j = 0; j < height; j++) total += LOAD_GLOBAL(ints, from + (size_t)j * plane_columns + p);
                STORE_PRIVATE(ints, sum + p) = total;
            }
            AT_EDGE
            for (; p < pixels; p++) {
                sum[p] = 0;
                for (int j = 0; j < height; j++) sum[p] += from[(size_t)j * plane_columns + p];
            }
            __global float *to = means + s * MEANS_PLANE(plane_rows, plane_columns) + (size_t)(y + MARGIN) * stride + MARGIN + x0;
            for (int x = 0; x < width; x += LANES) {
                const floats mean = CONVERT(sums_of_four(sum + x * BIN), floats) * (1.0f / (BIN * height));
                if (width - x >= LANES) STORE_GLOBAL(floats, to + x) = mean;
                else WRITE_FIRST(float, floats, to + x, mean, width - x);
            }
            if (pixels < width * BIN) to[width - 1] *= (float)BIN / (pixels - (width - 1) * BIN);
        }
}

KERNEL_OF_ONE bin_planes(__global const int *restrict planes, __global float *restrict means, int plane_rows, int plane_columns,
                         int rows, int columns) {
    bin_tile(GROUP_COLUMN, GROUP_ROW, planes, means, plane_rows, plane_columns, rows, columns);
}

COMPILED_ONCE soften_tile(int x0, int y0, __global const float *restrict means, __global float *restrict softened,
                          __global const float *restrict scale, int apart, int plane_rows, int plane_columns, int rows,
                          int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int stride = MEANS_STRIDE(plane_columns);
    const size_t plane = MEANS_PLANE(plane_rows, plane_columns);
    for (int y = y0; y < y1; y++)
        for (int x = 0; x < width; x += LANES) {
            const size_t at = (size_t)(y + MARGIN) * stride + MARGIN + x0 + x;
            floats own[3], inverse[3], change[3], weights = 0.25f;
            #pragma unroll
            for (int s = 0; s < 3; s++) {
                own[s] = LOAD_GLOBAL(floats, means + s * plane + at);
                change[s] = 0.0f;
            }
            inverse_scales(inverse, scale, own[LUMINANCE]);
            #pragma unroll
            for (int n = 0; n < 9; n++) {
                if (n == 4) continue;
                __global const float *there = means + at + (ptrdiff_t)(n / 3 - 1) * apart * stride + (n % 3 - 1) * apart;
                floats difference[3];
                #pragma unroll
                for (int s = 0; s < 3; s++) difference[s] = LOAD_GLOBAL(floats, there + s * plane) - own[s];
                const floats weight = likeness(difference, inverse) * (n % 2 ? 0.125f : 0.0625f);
                weights += weight;
                #pragma unroll
                for (int s = 0; s < 3; s++) change[s] += weight * difference[s];
            }
            const floats share = 1.0f / weights;
            for (int s = 0; s < 3; s++) {
                __global float *to = softened + s * plane + at;
                const floats mean = own[s] + change[s] * share;
                if (width - x >= LANES) STORE_GLOBAL(floats, to) = mean;
                else WRITE_FIRST(float, floats, to, mean, width - x);
            }
        }
}

KERNEL_OF_ONE soften(__global const float *restrict means, __global float *restrict softened, __global const float *restrict scale,
                     int apart, int plane_rows, int plane_columns, int rows, int columns) {
    soften_tile(GROUP_COLUMN, GROUP_ROW, means, softened, scale, apart, plane_rows, plane_columns, rows, columns);
}
