/* ------------------------------------------------------------------------------------------------------------------- tree */

/* Gradients and bends of the planes about padded row k - 1, and their products, as row k of the rings. */
static void plane_products(const Gradients *g, int k, int columns) {
    const int32_t *restrict factor = g->factor, *restrict shift = g->shift;
    const int32_t *restrict above = plane_row(g, L3_LUMINANCE, k - 2), *restrict here = plane_row(g, L3_LUMINANCE, k - 1);
    const int32_t *restrict below = plane_row(g, L3_LUMINANCE, k);
    const int32_t *restrict u_above = plane_row(g, 0, k - 2), *restrict u_here = plane_row(g, 0, k - 1);
    const int32_t *restrict u_below = plane_row(g, 0, k);
    const int32_t *restrict v_above = plane_row(g, 2, k - 2), *restrict v_here = plane_row(g, 2, k - 1);
    const int32_t *restrict v_below = plane_row(g, 2, k);
    int32_t *row[QUANTITIES];
    for (int q = 0; q < QUANTITIES; q++) row[q] = quantity_row(g, q, k);
    for (int p = 0; p < columns + 4; p++) {
        const int32_t f = factor[p], s = shift[p];
        const int32_t gx = scaled(here[p + 2] - here[p], f, s, L3_TREE_TOP);
        const int32_t gy = scaled(below[p + 1] - above[p + 1], f, s, L3_TREE_TOP);
        const int32_t bx = scaled(here[p] - 2 * here[p + 1] + here[p + 2], f, s, L3_TREE_TOP);
        const int32_t by = scaled(above[p + 1] - 2 * here[p + 1] + below[p + 1], f, s, L3_TREE_TOP);
        const int32_t ux = scaled(u_here[p + 2] - u_here[p], f, s, L3_TREE_CHROMA_TOP);
        const int32_t uy = scaled(u_below[p + 1] - u_above[p + 1], f, s, L3_TREE_CHROMA_TOP);
        const int32_t vx = scaled(v_here[p + 2] - v_here[p], f, s, L3_TREE_CHROMA_TOP);
        const int32_t vy = scaled(v_below[p + 1] - v_above[p + 1], f, s, L3_TREE_CHROMA_TOP);
        row[XX][p] = gx * gx, row[YY][p] = gy * gy, row[XY][p] = gx * gy;
        row[CHROMA_XX][p] = ux * ux + vx * vx, row[CHROMA_YY][p] = uy * uy + vy * vy;
        row[ALONG_FIRST][p] = gx * ux + gy * uy, row[ALONG_SECOND][p] = gx * vx + gy * vy;
        row[BEND_XX][p] = bx * bx, row[BEND_YY][p] = by * by;
        row[SLOPE_X][p] = gx, row[SLOPE_Y][p] = gy, row[BEND_X][p] = bx, row[BEND_Y][p] = by;
    }
}

static inline float squared_with_sign(int32_t value) { return (float)(value * (value < 0 ? -value : value)); }
static inline int32_t size_of(int32_t value) { return value < 0 ? -value : value; }

/* The sums that the tests of a row need: over 5 x 5 of the first seven quantities, then over 3 x 3. */
static void weigh_row(const Gradients *g, int k, int columns) {
    for (int q = XX; q <= ALONG_SECOND; q++) weigh_wide(g, q, k, columns, g->weighed + q * g->span);
    static const int near[] = {XX, YY, BEND_XX, BEND_YY, SLOPE_X, SLOPE_Y};
    for (int i = 0; i < 6; i++)
        weigh_near(g, quantity_row(g, near[i], k - 3), quantity_row(g, near[i], k - 2), quantity_row(g, near[i], k - 1), 1, columns,
                   g->weighed + (7 + i) * g->span);
    for (int plane = 0; plane < 3; plane++)
        weigh_near(g, plane_row(g, plane, k - 4), plane_row(g, plane, k - 3), plane_row(g, plane, k - 2), 2, columns,
                   g->weighed + (13 + plane) * g->span);
}

/* Numerators and denominators of every test (README.md, "Tree"), of a row. Rounding to float is the only one: IEEE-754's. */
static void find_evidence(const Gradients *g, int k, int columns) {
    const int32_t *restrict sum = g->weighed, *restrict bend_x = quantity_row(g, BEND_X, k - 2);
    const int32_t *restrict bend_y = quantity_row(g, BEND_Y, k - 2);
    const ptrdiff_t n = g->span;
    float *restrict to = g->numerator, *restrict below = g->denominator;
    for (int x = 0; x < columns; x++) {
        const int32_t xx = sum[x], yy = sum[n + x], diagonal = 2 * sum[2 * n + x];
        const int32_t chroma_xx = sum[3 * n + x], chroma_yy = sum[4 * n + x];
        const int32_t trace = xx + yy, chroma = chroma_xx + chroma_yy, straight = xx - yy;
        const int32_t both = ((size_of(straight) + size_of(diagonal)) >> 6) * 45;
        const int32_t larger = size_of(straight) > size_of(diagonal) ? size_of(straight) : size_of(diagonal);
        to[0 * n + x] = (float)trace;
        to[1 * n + x] = (float)straight;
        to[2 * n + x] = (float)diagonal;
        to[3 * n + x] = (float)(straight + diagonal);
        to[4 * n + x] = (float)(straight - diagonal);
        to[5 * n + x] = (float)(larger > both ? larger : both);
        to[6 * n + x] = (float)(sum[7 * n + x] + sum[8 * n + x]);
        to[7 * n + x] = to[8 * n + x] = (float)chroma;
        to[9 * n + x] = (float)(chroma_xx - chroma_yy);
        to[10 * n + x] = (float)sum[5 * n + x];
        to[11 * n + x] = (float)sum[6 * n + x];
        to[12 * n + x] = (float)sum[9 * n + x];
        to[13 * n + x] = (float)sum[10 * n + x];
        to[14 * n + x] = squared_with_sign(bend_x[x + 2]);
        to[15 * n + x] = squared_with_sign(bend_y[x + 2]);
        to[16 * n + x] = squared_with_sign(sum[11 * n + x]);
        to[17 * n + x] = squared_with_sign(sum[12 * n + x]);
        to[18 * n + x] = (float)sum[13 * n + x];
        to[19 * n + x] = (float)sum[15 * n + x];
        to[20 * n + x] = (float)sum[14 * n + x];
        below[0 * n + x] = 1.0f;
        below[1 * n + x] = (float)(trace + L3_NOISE_TRACE);
        below[2 * n + x] = (float)(chroma + L3_NOISE_TRACE);
        below[3 * n + x] = (float)(sum[14 * n + x] > L3_DARK ? sum[14 * n + x] : L3_DARK);
    }
}

/* Down the tree, for the pixel of column x. */
static uint32_t leaf_of(const Gradients *g, const L3Tree *tree, int x, int turn) {
    int node = 0;
    while (tree->branch[node] > 0) {
        const int test = tree->test[node];
        const float value = g->numerator[l3_turned_test[turn][test] * g->span + x] * (float)l3_turned_sign[turn][test];
        const float limit = tree->threshold[node] * g->denominator[l3_denominator[test] * g->span + x];
        node = tree->branch[node] + (value > limit);
    }
    return tree->leaf[node];
}

static void label_by_tree(const Gradients *g, const L3PlaneLayer *layer, const int32_t *planes, const uint32_t *first_labels, int rows,
                          int columns, int phase_row, int phase_column, uint32_t *labels) {
    for (int k = 0; k < rows + 2 * REACH; k++) {
        for (int plane = 0; plane < 3; plane++) read_plane(g, planes, plane, k, rows, columns);
        if (k < 2) continue;
        read_scale(g, layer, first_labels, k - 1, rows, columns);
        plane_products(g, k, columns);
        if (k < 2 * REACH) continue;
        weigh_row(g, k, columns);
        find_evidence(g, k, columns);
        const int y = k - 2 * REACH;
        for (int x = 0; x < columns; x++) {
            const ptrdiff_t at = (ptrdiff_t)y * columns + x;
            const uint32_t site = site_of(y, x, phase_row, phase_column);
            labels[at] = plane_class(layer, first_labels[at], site, leaf_of(g, layer->tree, x, layer->tree->turns[site]));
        }
    }
}

