// Graphics variant: planes → their means; means → those after an edge-avoiding step. A work-item a mean.

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void bin_planes(__global const int *restrict planes, __global float *restrict means, int plane_rows, int plane_columns, int rows,
                int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows) return;
    const int height = min(BIN, plane_rows - y * BIN), width = min(BIN, plane_columns - x * BIN);
    for (int s = 0; s < 3; s++) {
        __global const int *from = planes + ((size_t)s * plane_rows + y * BIN) * plane_columns + x * BIN;
        int sum = 0;
        for (int j = 0; j < height; j++)
            for (int i = 0; i < width; i++) sum += from[(size_t)j * plane_columns + i];
        means[s * MEANS_PLANE(plane_rows, plane_columns) + (size_t)(y + MARGIN) * MEANS_STRIDE(plane_columns) + MARGIN + x] =
            sum * (1.0f / (height * width));
    }
}

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void soften(__global const float *restrict means, __global float *restrict softened, __global const float *restrict scale,
            int apart, int plane_rows, int plane_columns, int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= columns || y >= rows) return;
    const int stride = MEANS_STRIDE(plane_columns);
    const size_t plane = MEANS_PLANE(plane_rows, plane_columns), at = (size_t)(y + MARGIN) * stride + MARGIN + x;
    float own[3], inverse[3], change[3] = {0}, weights = 0.25f;
    for (int s = 0; s < 3; s++) own[s] = means[s * plane + at];
    inverse_scales(inverse, scale, own[LUMINANCE]);
    for (int n = 0; n < 9; n++) {
        if (n == 4) continue;
        __global const float *there = means + at + (n / 3 - 1) * apart * stride + (n % 3 - 1) * apart;
        float difference[3];
        for (int s = 0; s < 3; s++) difference[s] = there[s * plane] - own[s];
        const float weight = likeness(difference, inverse) * (n % 2 ? 0.125f : 0.0625f);
        weights += weight;
        for (int s = 0; s < 3; s++) change[s] += weight * difference[s];
    }
    for (int s = 0; s < 3; s++) softened[s * plane + at] = own[s] + change[s] / weights;
}
