// Processor variant: planes → quads and blocks; blocks → those after an edge-avoiding step; quads → what they read of blocks. One
// work-item takes a tile of blocks, or of quads.

#define PAIRED(a, b) (__builtin_shufflevector(a, b, ALL_LANES(EVEN)) + __builtin_shufflevector(a, b, ALL_LANES(ODD)))
#define STORE_FIRST(to, value, count) do { \
    if ((count) >= LANES) STORE_GLOBAL(floats, to) = value; \
    else WRITE_FIRST(float, floats, to, value, count); \
} while (0)

// The quad at a column of a plane from two of its rows.
INLINE float quad_of(__global const int *above, __global const int *below, int column, int columns) {
    const int first = min(2 * column, columns - 1), second = min(2 * column + 1, columns - 1);
    return (float)(above[first] + above[second] + below[first] + below[second]) * 0.25f;
}

COMPILED_ONCE halve_tile(int x0, int y0, __global const int *restrict planes, __global float *restrict quads,
                         __global float *restrict blocks, int plane_rows, int plane_columns, int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), x1 = min(x0 + TILE, columns), quad_rows = HALF(plane_rows), last = HALF(plane_columns) - 1;
    for (int s = 0; s < 3; s++)
        for (int y = y0; y < y1; y++) {
            __global const int *above[2], *below[2];
            __global float *to[2];
            for (int r = 0; r < 2; r++) {
                const int quad_row = min(2 * y + r, quad_rows - 1);
                __global const int *plane = planes + (size_t)s * plane_rows * plane_columns;
                above[r] = plane + (size_t)(2 * quad_row) * plane_columns;
                below[r] = plane + (size_t)min(2 * quad_row + 1, plane_rows - 1) * plane_columns;
                to[r] = quads + s * QUADS_PLANE(plane_rows, plane_columns) + (size_t)quad_row * QUADS_STRIDE(plane_columns) + 1;
            }
            __global float *block = blocks + s * BLOCKS_PLANE(plane_rows, plane_columns)
                                  + (size_t)(y + MARGIN) * BLOCKS_STRIDE(plane_columns) + MARGIN;
            int x = x0;
            for (; x + LANES <= x1 && 4 * (x + LANES) <= plane_columns; x += LANES) {
                floats both[2];
                #pragma unroll
                for (int h = 0; h < 2; h++) {
                    both[h] = 0.0f;
                    #pragma unroll
                    for (int r = 0; r < 2; r++) {
                        const int at = 4 * x + 2 * h * LANES;
                        const ints a = LOAD_GLOBAL(ints, above[r] + at) + LOAD_GLOBAL(ints, below[r] + at);
                        const ints b = LOAD_GLOBAL(ints, above[r] + at + LANES) + LOAD_GLOBAL(ints, below[r] + at + LANES);
                        const floats quad = CONVERT(PAIRED(a, b), floats) * 0.25f;
                        STORE_GLOBAL(floats, to[r] + 2 * x + h * LANES) = quad;
                        both[h] += quad;
                    }
                }
                STORE_GLOBAL(floats, block + x) = PAIRED(both[0], both[1]) * 0.25f;
            }
            AT_EDGE
            for (; x < x1; x++) {
                float sum = 0.0f;
                for (int r = 0; r < 2; r++)
                    for (int h = 0; h < 2; h++) {
                        const int column = min(2 * x + h, last);
                        sum += to[r][column] = quad_of(above[r], below[r], column, plane_columns);
                    }
                block[x] = sum * 0.25f;
            }
            for (int r = 0; r < 2; r++) {
                if (x0 == 0) to[r][-1] = to[r][0];
                if (x1 == columns) to[r][last + 1] = to[r][last];
            }
        }
}

KERNEL_OF_ONE halve(__global const int *restrict planes, __global float *restrict quads, __global float *restrict blocks,
                    int plane_rows, int plane_columns, int rows, int columns) {
    halve_tile(GROUP_COLUMN, GROUP_ROW, planes, quads, blocks, plane_rows, plane_columns, rows, columns);
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

#define LOW(i) (NEAREST(i) + 1)
#define HIGH(i) (NEAREST(i) + 2)
#define OF_BLOCK(v, next) ((next) ? __builtin_shufflevector(v, v, ALL_LANES(HIGH)) : __builtin_shufflevector(v, v, ALL_LANES(LOW)))

COMPILED_ONCE read_tile(int x0, int y0, __global const float *restrict quads, __global const float *restrict first_blocks,
                        __global const float *restrict last_blocks, __global const float *restrict scale,
                        __global float *restrict far, int plane_rows, int plane_columns, int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int stride = QUADS_STRIDE(plane_columns), block_stride = BLOCKS_STRIDE(plane_columns);
    const size_t plane = QUADS_PLANE(plane_rows, plane_columns), block_plane = BLOCKS_PLANE(plane_rows, plane_columns);
    const floats across = (floats)(ALL_LANES(NEXT_SHARE));
    float down[3][TILE + 2 + LANES];  // of three rows
    for (int y = y0; y < y1; y++) {
        const ptrdiff_t above = y > 0 ? -stride : 0, below = y < rows - 1 ? stride : 0;
        for (int s = 0; s < 3; s++) {
            __global const float *row = quads + s * plane + (size_t)y * stride + x0;
            const float middle = s == LUMINANCE ? 4.0f : 1.0f;
            for (int p = 0; p < width + 2; p += LANES)
                STORE_PRIVATE(floats, down[s] + p) =
                    LOAD_GLOBAL(floats, row + above + p) + LOAD_GLOBAL(floats, row + below + p) + middle * LOAD_GLOBAL(floats, row + p);
        }
        for (int x = 0; x < width; x += LANES) {
            floats own[3], inverse[3], total[2] = {0.0f, 0.0f}, weights = 0.0f;
            #pragma unroll
            for (int s = 0; s < 3; s++) {
                const float middle = s == LUMINANCE ? 4.0f : 1.0f;
                own[s] = (LOAD_PRIVATE(floats, down[s] + x) + LOAD_PRIVATE(floats, down[s] + x + 2)
                          + middle * LOAD_PRIVATE(floats, down[s] + x + 1)) * (s == LUMINANCE ? 1.0f / 36 : 1.0f / 9);
            }
            inverse_scales(inverse, scale, own[LUMINANCE]);
            const size_t at = (size_t)(NEAREST(y) + MARGIN) * block_stride + MARGIN + (x0 + x) / 2 - 1;
            #pragma unroll
            for (int j = 0; j < 2; j++) {
                floats first[3], last[2];
                #pragma unroll
                for (int s = 0; s < 3; s++) first[s] = LOAD_GLOBAL(floats, first_blocks + s * block_plane + at + j * block_stride);
                #pragma unroll
                for (int s = 0; s < 2; s++) last[s] = LOAD_GLOBAL(floats, last_blocks + 2 * s * block_plane + at + j * block_stride);
                const float share = j ? NEXT_SHARE(y) : 1.0f - NEXT_SHARE(y);
                #pragma unroll
                for (int i = 0; i < 2; i++) {
                    floats difference[3];
                    #pragma unroll
                    for (int s = 0; s < 3; s++) difference[s] = OF_BLOCK(first[s], i) - own[s];
                    const floats weight = likeness(difference, inverse) * ((i ? across : 1.0f - across) * share);
                    weights += weight;
                    #pragma unroll
                    for (int s = 0; s < 2; s++) total[s] += weight * OF_BLOCK(last[s], i);
                }
            }
            const floats share = 1.0f / (weights + OWN);
            __global float *to = far + (size_t)y * stride + x0 + x;
            STORE_FIRST(to, total[0] * share, width - x);
            STORE_FIRST(to + plane, total[1] * share, width - x);
            STORE_FIRST(to + 2 * plane, weights * share, width - x);
        }
    }
}

KERNEL_OF_ONE read_far(__global const float *restrict quads, __global const float *restrict first_blocks,
                       __global const float *restrict last_blocks, __global const float *restrict scale,
                       __global float *restrict far, int plane_rows, int plane_columns, int rows, int columns) {
    read_tile(GROUP_COLUMN, GROUP_ROW, quads, first_blocks, last_blocks, scale, far, plane_rows, plane_columns, rows, columns);
}
