// Graphics variant: averages planes over blocks, and smooths the blocks while preserving edges. Each work-item processes one block.

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void average(__global const int *restrict planes, __global float *restrict blocks, int plane_rows, int plane_columns, int rows,
             int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows) return;
    for (int s = 0; s < 3; s++) {
        int sum = 0;
        for (int n = 0; n < 16; n++) {
            const int row = min(4 * y + n / 4, plane_rows - 1), column = min(4 * x + n % 4, plane_columns - 1);
            sum += planes[((size_t)s * plane_rows + row) * plane_columns + column];
        }
        blocks[s * BLOCKS_PLANE(plane_rows, plane_columns) + (size_t)(y + MARGIN) * BLOCKS_STRIDE(plane_columns) + MARGIN + x] =
            (float)sum * (1.0f / 16);
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
