// Graphics variant: computes the classes of a refinement layer with a decision tree, from its planes and the classes of the first layer.
// Each work-item processes one pixel.

// A node has two words. The first contains the bits of the threshold. The second contains the index of the numerator, the index of the
// denominator (from bit 6) and the number of the first of two consecutive child nodes (from bit 8). A leaf is its own child, and no value
// exceeds its threshold.
#define STRUCTURE_CONSTANTS LABEL_CONSTANTS, __global const uint *restrict nodes, __global const uint *restrict leaf_of_node

// Returns the child node. It is selected by one product and one comparison in float32, so it is the same on every device.
INLINE uint next_node(uint node, const Evidence *e, __global const uint *nodes) {
    const uint word = nodes[2 * node + 1];
    return (word >> 8) + (e->numerator[word & 0x3f] > as_float(nodes[2 * node]) * e->denominator[word >> 6 & 3]);
}

#ifndef TRANSFORM_ONLY  // another program contains this kernel if TRANSFORM_ONLY is set
__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void structures(STRUCTURES_PARAMETERS) {
    const int x = get_group_id(0) * TILE + get_local_id(0), y = get_group_id(1) * BAND + get_local_id(1);
    if (x >= columns || y >= rows) return;
    const size_t stride = (size_t)source_rows * columns;
    __global const int *u = planes, *luminance = planes + stride, *v = planes + 2 * stride;
    Sums s = {0};
    for (int i = 1; i < 2 * STRUCTURE_REACH; i++) {
        const size_t above = (size_t)row_source[y + i - 1] * columns, middle = (size_t)row_source[y + i] * columns;
        const size_t below = (size_t)row_source[y + i + 1] * columns, labelled = (size_t)label_source[y + i] * columns;
        for (int j = 1; j < 2 * STRUCTURE_REACH; j++) {
            const int left = column_source[x + j - 1], at = column_source[x + j], right = column_source[x + j + 1];
            const uint scale = (uint)label_words[first_labels[labelled + at]];
#define ACROSS_OF(plane, top) gradient(plane[middle + right] - plane[middle + left], scale, top)
#define DOWN_OF(plane, top) gradient(plane[below + at] - plane[above + at], scale, top)
#define BEND_ACROSS_OF(plane, top) gradient(plane[middle + left] - 2 * plane[middle + at] + plane[middle + right], scale, top)
#define BEND_DOWN_OF(plane, top) gradient(plane[above + at] - 2 * plane[middle + at] + plane[below + at], scale, top)
            const int gx = ACROSS_OF(luminance, GRADIENT_TOP), gy = DOWN_OF(luminance, GRADIENT_TOP);
            const int ux = ACROSS_OF(u, CHROMA_TOP), uy = DOWN_OF(u, CHROMA_TOP);
            const int vx = ACROSS_OF(v, CHROMA_TOP), vy = DOWN_OF(v, CHROMA_TOP);
            const int ubx = BEND_ACROSS_OF(u, CHROMA_TOP), uby = BEND_DOWN_OF(u, CHROMA_TOP);
            const int vbx = BEND_ACROSS_OF(v, CHROMA_TOP), vby = BEND_DOWN_OF(v, CHROMA_TOP);
            const int from_row = abs(i - STRUCTURE_REACH), from_column = abs(j - STRUCTURE_REACH);
            const int wide = (3 - from_row) * (3 - from_column);
            s.xx += wide * gx * gx;
            s.yy += wide * gy * gy;
            s.xy += wide * gx * gy;
            s.chroma_xx += wide * (ux * ux + vx * vx);
            s.chroma_yy += wide * (uy * uy + vy * vy);
            s.u_along += wide * (gx * ux + gy * uy);
            s.v_along += wide * (gx * vx + gy * vy);
            s.chroma_bend_xx += wide * (ubx * ubx + vbx * vbx);
            s.chroma_bend_yy += wide * (uby * uby + vby * vby);
            if (from_row > 1 || from_column > 1) continue;
            const int narrow = (2 - from_row) * (2 - from_column);
            const int bend_x = BEND_ACROSS_OF(luminance, GRADIENT_TOP), bend_y = BEND_DOWN_OF(luminance, GRADIENT_TOP);
            s.narrow_strength += narrow * (gx * gx + gy * gy);
            s.bend_xx += narrow * bend_x * bend_x;
            s.bend_yy += narrow * bend_y * bend_y;
            s.slope_x += narrow * gx;
            s.slope_y += narrow * gy;
            s.u += narrow * u[middle + at];
            s.v += narrow * v[middle + at];
            s.luminance += narrow * luminance[middle + at];
            if (from_row == 0 && from_column == 0) {
                s.bend_x = bend_x;
                s.bend_y = bend_y;
            }
        }
    }
    const uint label = first_labels[(size_t)label_source[y + STRUCTURE_REACH] * columns + column_source[x + STRUCTURE_REACH]];
    const ulong words = label_words[label];
    const uint first = words >> 32;
    Evidence evidence;
    turn(&s, (uint)words);
    weigh(&evidence, &s);
    uint node = 0;
    for (int step = 0; step < DEPTH; step++) node = next_node(node, &evidence, nodes);
    labels[(size_t)y * columns + x] = FIRST_CLASS(first) + (DECIDED(first) ? 0 : leaf_of_node[node]);
}
#endif
