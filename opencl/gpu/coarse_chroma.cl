// Graphics variant: planes → quads and blocks; blocks → those after an edge-avoiding step; quads → what they read of blocks. A
// work-item a block, or a quad.

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void halve(__global const int *restrict planes, __global float *restrict quads, __global float *restrict blocks, int plane_rows,
           int plane_columns, int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1), last = HALF(plane_columns) - 1, last_row = HALF(plane_rows) - 1;
    if (x >= columns || y >= rows) return;
    for (int s = 0; s < 3; s++) {
        __global const int *plane = planes + (size_t)s * plane_rows * plane_columns;
        float sum = 0.0f;
        for (int n = 0; n < 4; n++) {
            const int row = min(2 * y + n / 2, last_row), column = min(2 * x + n % 2, last);
            __global const int *above = plane + (size_t)(2 * row) * plane_columns;
            __global const int *below = plane + (size_t)min(2 * row + 1, plane_rows - 1) * plane_columns;
            const int second = min(2 * column + 1, plane_columns - 1);
            const float quad = (float)(above[2 * column] + above[second] + below[2 * column] + below[second]) * 0.25f;
            __global float *to = quads + s * QUADS_PLANE(plane_rows, plane_columns) + (size_t)row * QUADS_STRIDE(plane_columns) + 1;
            to[column] = quad;
            if (column == 0) to[-1] = quad;
            if (column == last) to[last + 1] = quad;
            sum += quad;
        }
        blocks[s * BLOCKS_PLANE(plane_rows, plane_columns) + (size_t)(y + MARGIN) * BLOCKS_STRIDE(plane_columns) + MARGIN + x] =
            sum * 0.25f;
    }
}

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void soften(__global const float *restrict blocks, __global float *restrict softened, __global const float *restrict scale,
            int spacing, int plane_rows, int plane_columns, int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1), stride = BLOCKS_STRIDE(plane_columns);
    if (x >= columns || y >= rows) return;
    const size_t plane = BLOCKS_PLANE(plane_rows, plane_columns), at = (size_t)(y + MARGIN) * stride + MARGIN + x;
    float own[3], inverse[3], change[3] = {0}, weights = STEP_WEIGHT(4);
    for (int s = 0; s < 3; s++) own[s] = blocks[s * plane + at];
    inverse_scales(inverse, scale, own[LUMINANCE]);
    for (int n = 0; n < 9; n++) {
        if (n == 4) continue;
        __global const float *there = blocks + at + ((n / 3 - 1) * stride + n % 3 - 1) * spacing;
        float difference[3];
        for (int s = 0; s < 3; s++) difference[s] = there[s * plane] - own[s];
        const float weight = likeness(difference, inverse) * STEP_WEIGHT(n);
        weights += weight;
        for (int s = 0; s < 3; s++) change[s] += weight * difference[s];
    }
    for (int s = 0; s < 3; s++) softened[s * plane + at] = own[s] + change[s] / weights;
}

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void read_far(__global const float *restrict quads, __global const float *restrict first_blocks,
              __global const float *restrict last_blocks, __global const float *restrict scale, __global float *restrict far,
              int plane_rows, int plane_columns, int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1), stride = QUADS_STRIDE(plane_columns);
    if (x >= columns || y >= rows) return;
    const size_t plane = QUADS_PLANE(plane_rows, plane_columns), block_plane = BLOCKS_PLANE(plane_rows, plane_columns);
    float own[3] = {0}, inverse[3], total[2] = {0}, weights = 0.0f;
    for (int n = 0; n < 9; n++) {
        const int row = clamp(y + n / 3 - 1, 0, rows - 1);
        for (int s = 0; s < 3; s++)
            own[s] += quads[s * plane + (size_t)row * stride + x + n % 3]
                    * (s != LUMINANCE ? 1.0f / 9 : n == 4 ? 16.0f / 36 : n % 2 ? 4.0f / 36 : 1.0f / 36);
    }
    inverse_scales(inverse, scale, own[LUMINANCE]);
    for (int n = 0; n < 4; n++) {
        const size_t there = (size_t)(NEAREST(y) + MARGIN + n / 2) * BLOCKS_STRIDE(plane_columns) + MARGIN + NEAREST(x) + n % 2;
        float difference[3];
        for (int s = 0; s < 3; s++) difference[s] = first_blocks[s * block_plane + there] - own[s];
        const float part = (n / 2 ? NEXT_SHARE(y) : 1.0f - NEXT_SHARE(y)) * (n % 2 ? NEXT_SHARE(x) : 1.0f - NEXT_SHARE(x));
        const float weight = likeness(difference, inverse) * part;
        weights += weight;
        for (int s = 0; s < 2; s++) total[s] += weight * last_blocks[2 * s * block_plane + there];
    }
    __global float *to = far + (size_t)y * stride + x;
    for (int s = 0; s < 2; s++) to[s * plane] = total[s] / (weights + OWN);
    to[2 * plane] = weights / (weights + OWN);
}
