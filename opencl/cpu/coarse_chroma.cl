// Processor variant: averages planes over blocks, and smooths the blocks while preserving edges. Each work-item processes one tile of blocks.

#define PAIRED(a, b) (__builtin_shufflevector(a, b, ALL_LANES(EVEN)) + __builtin_shufflevector(a, b, ALL_LANES(ODD)))

COMPILED_ONCE average_tile(int x0, int y0, __global const int *restrict planes, __global float *restrict blocks, int plane_rows,
                           int plane_columns, int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), x1 = min(x0 + TILE, columns);
    for (int s = 0; s < 3; s++)
        for (int y = y0; y < y1; y++) {
            __global const int *row[4];
            for (int r = 0; r < 4; r++) row[r] = planes + ((size_t)s * plane_rows + min(4 * y + r, plane_rows - 1)) * plane_columns;
            __global float *block = blocks + s * BLOCKS_PLANE(plane_rows, plane_columns)
                                  + (size_t)(y + MARGIN) * BLOCKS_STRIDE(plane_columns) + MARGIN;
            int x = x0;
            for (; x + LANES <= x1 && 4 * (x + LANES) <= plane_columns; x += LANES) {
                ints down[4];
                #pragma unroll
                for (int v = 0; v < 4; v++) {
                    down[v] = 0;
                    #pragma unroll
                    for (int r = 0; r < 4; r++) down[v] += LOAD_GLOBAL(ints, row[r] + 4 * x + v * LANES);
                }
                const ints first = PAIRED(down[0], down[1]), second = PAIRED(down[2], down[3]);
                STORE_GLOBAL(floats, block + x) = CONVERT(PAIRED(first, second), floats) * (1.0f / 16);
            }
            AT_EDGE
            for (; x < x1; x++) {
                int sum = 0;
                for (int n = 0; n < 16; n++) sum += row[n / 4][min(4 * x + n % 4, plane_columns - 1)];
                block[x] = (float)sum * (1.0f / 16);
            }
        }
}

KERNEL_OF_ONE average(__global const int *restrict planes, __global float *restrict blocks, int plane_rows, int plane_columns, int rows,
                      int columns) {
    average_tile(GROUP_COLUMN, GROUP_ROW, planes, blocks, plane_rows, plane_columns, rows, columns);
}

COMPILED_ONCE soften_tile(int x0, int y0, __global const float *restrict blocks, __global float *restrict softened,
                          __global const float *restrict scale, int spacing, int plane_rows, int plane_columns, int rows,
                          int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0), stride = BLOCKS_STRIDE(plane_columns);
    const size_t plane = BLOCKS_PLANE(plane_rows, plane_columns);
    for (int y = y0; y < y1; y++)
        for (int x = 0; x < width; x += LANES) {
            const size_t at = (size_t)(y + MARGIN) * stride + MARGIN + x0 + x;
            floats own[3], inverse[3], change[3], weights = STEP_WEIGHT(4);
            #pragma unroll
            for (int s = 0; s < 3; s++) {
                own[s] = LOAD_GLOBAL(floats, blocks + s * plane + at);
                change[s] = 0.0f;
            }
            inverse_scales(inverse, scale, own[LUMINANCE]);
            #pragma unroll
            for (int n = 0; n < 9; n++) {
                if (n == 4) continue;
                __global const float *there = blocks + at + (ptrdiff_t)((n / 3 - 1) * stride + n % 3 - 1) * spacing;
                floats difference[3];
                #pragma unroll
                for (int s = 0; s < 3; s++) difference[s] = LOAD_GLOBAL(floats, there + s * plane) - own[s];
                const floats weight = likeness(difference, inverse) * STEP_WEIGHT(n);
                weights += weight;
                #pragma unroll
                for (int s = 0; s < 3; s++) change[s] += weight * difference[s];
            }
            const floats share = 1.0f / weights;
            for (int s = 0; s < 3; s++) STORE_FIRST(softened + s * plane + at, own[s] + change[s] * share, width - x);
        }
}

KERNEL_OF_ONE soften(__global const float *restrict blocks, __global float *restrict softened, __global const float *restrict scale,
                     int spacing, int plane_rows, int plane_columns, int rows, int columns) {
    soften_tile(GROUP_COLUMN, GROUP_ROW, blocks, softened, scale, spacing, plane_rows, plane_columns, rows, columns);
}
