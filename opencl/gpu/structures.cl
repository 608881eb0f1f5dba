// Graphics variant: computes the classes of a refinement layer from the luminance plane and the classes of the first layer.
// Each work-item processes one pixel.

#ifndef TRANSFORM_ONLY  // another program contains this kernel if TRANSFORM_ONLY is set
__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void structures(STRUCTURES_PARAMETERS) {
    const int x = get_group_id(0) * TILE + get_local_id(0), y = get_group_id(1) * BAND + get_local_id(1);
    if (x >= columns || y >= rows) return;
    __global const int *luminance = planes + (size_t)LUMINANCE * source_rows * columns;
    uint xx = 0, yy = 0;
    int xy = 0;
    for (int i = 1; i < 2 * STRUCTURE_REACH; i++) {
        const size_t above = (size_t)row_source[y + i - 1] * columns, middle = (size_t)row_source[y + i] * columns;
        const size_t below = (size_t)row_source[y + i + 1] * columns, labelled = (size_t)label_source[y + i] * columns;
        for (int j = 1; j < 2 * STRUCTURE_REACH; j++) {
            const int left = column_source[x + j - 1], at = column_source[x + j], right = column_source[x + j + 1];
            const uint scale = (uint)label_words[first_labels[labelled + at]];
            const int gx = gradient(luminance[middle + right] - luminance[middle + left], scale, GRADIENT_TOP);
            const int gy = gradient(luminance[below + at] - luminance[above + at], scale, GRADIENT_TOP);
            const int weight = (3 - abs(i - STRUCTURE_REACH)) * (3 - abs(j - STRUCTURE_REACH));
            xx += weight * gx * gx;
            yy += weight * gy * gy;
            xy += weight * gx * gy;
        }
    }
    const uint label = first_labels[(size_t)label_source[y + STRUCTURE_REACH] * columns + column_source[x + STRUCTURE_REACH]];
    const ulong words = label_words[label];
    const uint first = words >> 32;
    const uint structure = structure_of(xx, yy, xy, (uint)words, strength_edges);
    labels[(size_t)y * columns + x] = DECIDED(first) ? FIRST_CLASS(first) : first + structure;
}
#endif
