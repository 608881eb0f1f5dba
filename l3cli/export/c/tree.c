/* ------------------------------------------------------------------------------------------------------------------- tree */

/* Computes the first differences (slopes) and second differences (bends) of the luminance in a padded row, and their products. */
static void luminance_slopes(const int32_t *restrict above, const int32_t *restrict here, const int32_t *restrict below,
                             const int32_t *restrict factor, const int32_t *restrict shift, int columns, int32_t *restrict slope_x,
                             int32_t *restrict slope_y, int32_t *restrict bend_x, int32_t *restrict bend_y, int32_t *restrict xx,
                             int32_t *restrict yy, int32_t *restrict xy, int32_t *restrict bend_xx, int32_t *restrict bend_yy) {
    for (int p = 0; p < columns + 4; p++) {
        const int32_t f = factor[p], s = shift[p], twice = 2 * here[p + 1];
        const int32_t gx = scaled(here[p + 2] - here[p], f, s, L3_TREE_TOP);
        const int32_t gy = scaled(below[p + 1] - above[p + 1], f, s, L3_TREE_TOP);
        const int32_t bx = scaled(here[p] - twice + here[p + 2], f, s, L3_TREE_TOP);
        const int32_t by = scaled(above[p + 1] - twice + below[p + 1], f, s, L3_TREE_TOP);
        slope_x[p] = gx, slope_y[p] = gy, bend_x[p] = bx, bend_y[p] = by;
        xx[p] = gx * gx, yy[p] = gy * gy, xy[p] = gx * gy, bend_xx[p] = bx * bx, bend_yy[p] = by * by;
    }
}

/* Computes the products of the chroma gradients with each other and with the luminance gradients. */
static void chroma_slopes(const int32_t *restrict u_above, const int32_t *restrict u_here, const int32_t *restrict u_below,
                          const int32_t *restrict v_above, const int32_t *restrict v_here, const int32_t *restrict v_below,
                          const int32_t *restrict factor, const int32_t *restrict shift, const int32_t *restrict slope_x,
                          const int32_t *restrict slope_y, int columns, int32_t *restrict xx, int32_t *restrict yy,
                          int32_t *restrict first, int32_t *restrict second, int32_t *restrict bend_xx,
                          int32_t *restrict bend_yy) {
    for (int p = 0; p < columns + 4; p++) {
        const int32_t f = factor[p], s = shift[p], gx = slope_x[p], gy = slope_y[p];
        const int32_t ux = scaled(u_here[p + 2] - u_here[p], f, s, L3_TREE_CHROMA_TOP);
        const int32_t uy = scaled(u_below[p + 1] - u_above[p + 1], f, s, L3_TREE_CHROMA_TOP);
        const int32_t vx = scaled(v_here[p + 2] - v_here[p], f, s, L3_TREE_CHROMA_TOP);
        const int32_t vy = scaled(v_below[p + 1] - v_above[p + 1], f, s, L3_TREE_CHROMA_TOP);
        xx[p] = ux * ux + vx * vx, yy[p] = uy * uy + vy * vy;
        const int32_t ubx = scaled(u_here[p] - 2 * u_here[p + 1] + u_here[p + 2], f, s, L3_TREE_CHROMA_TOP);
        const int32_t uby = scaled(u_above[p + 1] - 2 * u_here[p + 1] + u_below[p + 1], f, s, L3_TREE_CHROMA_TOP);
        const int32_t vbx = scaled(v_here[p] - 2 * v_here[p + 1] + v_here[p + 2], f, s, L3_TREE_CHROMA_TOP);
        const int32_t vby = scaled(v_above[p + 1] - 2 * v_here[p + 1] + v_below[p + 1], f, s, L3_TREE_CHROMA_TOP);
        bend_xx[p] = ubx * ubx + vbx * vbx, bend_yy[p] = uby * uby + vby * vby;
        first[p] = gx * ux + gy * uy, second[p] = gx * vx + gy * vy;
    }
}

/* Computes slopes, bends and products at padded row k - 1, and stores them as row k of the rings. */
static void plane_products(const Gradients *g, int k, int columns) {
    int32_t *row[QUANTITIES];
    for (int q = 0; q < QUANTITIES; q++) row[q] = quantity_row(g, q, k);
    luminance_slopes(plane_row(g, L3_LUMINANCE, k - 2), plane_row(g, L3_LUMINANCE, k - 1), plane_row(g, L3_LUMINANCE, k), g->factor,
                     g->shift, columns, row[SLOPE_X], row[SLOPE_Y], row[BEND_X], row[BEND_Y], row[XX], row[YY], row[XY], row[BEND_XX],
                     row[BEND_YY]);
    chroma_slopes(plane_row(g, 0, k - 2), plane_row(g, 0, k - 1), plane_row(g, 0, k), plane_row(g, 2, k - 2), plane_row(g, 2, k - 1),
                  plane_row(g, 2, k), g->factor, g->shift, row[SLOPE_X], row[SLOPE_Y], columns, row[CHROMA_XX], row[CHROMA_YY],
                  row[ALONG_FIRST], row[ALONG_SECOND], row[CHROMA_BEND_XX], row[CHROMA_BEND_YY]);
}

static inline int32_t size_of(int32_t value) { return negated(value, value >> 31); }
static inline int32_t larger_of(int32_t a, int32_t b) { return a > b ? a : b; }
static inline float squared_with_sign(int32_t value) { return (float)(value * size_of(value)); }

/* Computes the weighted sums for the tests of a row: the first nine quantities over 5 x 5 pixels, and the other sums over 3 x 3 pixels. */
static void weigh_row(const Gradients *g, int k, int columns) {
    for (int q = XX; q <= CHROMA_BEND_YY; q++) weigh_wide(g, q, k, columns, g->weighed + q * g->span);
    static const int near[] = {XX, YY, BEND_XX, BEND_YY, SLOPE_X, SLOPE_Y};
    for (int i = 0; i < 6; i++)
        weigh_near(g, quantity_row(g, near[i], k - 3), quantity_row(g, near[i], k - 2), quantity_row(g, near[i], k - 1), 1, columns,
                   g->weighed + (9 + i) * g->span);
    for (int plane = 0; plane < 3; plane++)
        weigh_near(g, plane_row(g, plane, k - 4), plane_row(g, plane, k - 3), plane_row(g, plane, k - 2), 2, columns,
                   g->weighed + (15 + plane) * g->span);
}

/* Numerators and denominators of TOGETHER pixels of a row, and the orientation of each pixel: masks with all bits set, or 0. */
typedef struct {
    float numerator[L3_TESTS][TOGETHER], denominator[4][TOGETHER];
    int32_t transposed[TOGETHER], across[TOGETHER], down[TOGETHER];
} TreeEvidence;

/* Computes the numerators and denominators of all tests (see "Tree" in README.md), starting at column x. Each pixel is evaluated in the
 * orientation in which its site was trained: rows and columns may be exchanged, and their signs may change. The conversion to float is
 * the only rounding. */
static void find_evidence(const Gradients *g, int k, int x, TreeEvidence *restrict e) {
    const ptrdiff_t n = g->span;
    const int32_t *restrict sum = g->weighed + x, *restrict bend_x = quantity_row(g, BEND_X, k - 2) + x + 2;
    const int32_t *restrict bend_y = quantity_row(g, BEND_Y, k - 2) + x + 2;
    for (int i = 0; i < TOGETHER; i++) {
        const int32_t mask = e->transposed[i], swap = (sum[i] ^ sum[n + i]) & mask;
        const int32_t xx = sum[i] ^ swap, yy = sum[n + i] ^ swap;
        const int32_t chroma_swap = (sum[3 * n + i] ^ sum[4 * n + i]) & mask;
        const int32_t chroma_xx = sum[3 * n + i] ^ chroma_swap, chroma_yy = sum[4 * n + i] ^ chroma_swap;
        const int32_t fine_swap = (sum[7 * n + i] ^ sum[8 * n + i]) & mask;
        const int32_t fine_xx = sum[7 * n + i] ^ fine_swap, fine_yy = sum[8 * n + i] ^ fine_swap;
        const int32_t curve_swap = (sum[11 * n + i] ^ sum[12 * n + i]) & mask;
        const int32_t slope_swap = (sum[13 * n + i] ^ sum[14 * n + i]) & mask;
        const int32_t bend_swap = (bend_x[i] ^ bend_y[i]) & mask;
        const int32_t diagonal = 2 * negated(sum[2 * n + i], e->across[i] ^ e->down[i]), luminance = sum[16 * n + i];
        const int32_t trace = xx + yy, chroma = chroma_xx + chroma_yy, straight = xx - yy;
        const int32_t both = ((size_of(straight) + size_of(diagonal)) >> 6) * 45;
        const int32_t along = larger_of(larger_of(size_of(straight), size_of(diagonal)), both);
        e->numerator[0][i] = (float)trace;
        e->numerator[1][i] = (float)straight;
        e->numerator[2][i] = (float)diagonal;
        e->numerator[3][i] = (float)(straight + diagonal);
        e->numerator[4][i] = (float)(straight - diagonal);
        e->numerator[5][i] = (float)along;
        e->numerator[6][i] = (float)(sum[9 * n + i] + sum[10 * n + i]);
        e->numerator[7][i] = e->numerator[8][i] = (float)chroma;
        e->numerator[9][i] = (float)(chroma_xx - chroma_yy);
        e->numerator[10][i] = (float)sum[5 * n + i];
        e->numerator[11][i] = (float)sum[6 * n + i];
        e->numerator[12][i] = (float)(sum[11 * n + i] ^ curve_swap);
        e->numerator[13][i] = (float)(sum[12 * n + i] ^ curve_swap);
        e->numerator[14][i] = squared_with_sign(bend_x[i] ^ bend_swap);
        e->numerator[15][i] = squared_with_sign(bend_y[i] ^ bend_swap);
        e->numerator[16][i] = squared_with_sign(negated(sum[13 * n + i] ^ slope_swap, e->across[i]));
        e->numerator[17][i] = squared_with_sign(negated(sum[14 * n + i] ^ slope_swap, e->down[i]));
        e->numerator[18][i] = (float)sum[15 * n + i];
        e->numerator[19][i] = (float)sum[17 * n + i];
        e->numerator[20][i] = (float)luminance;
        e->numerator[21][i] = (float)(fine_xx - fine_yy);
        e->numerator[22][i] = (float)(fine_xx + fine_yy);
        e->denominator[0][i] = 1.0f;
        e->denominator[1][i] = (float)(trace + L3_NOISE_TRACE);
        e->denominator[2][i] = (float)(chroma + L3_NOISE_TRACE);
        e->denominator[3][i] = (float)larger_of(luminance, L3_DARK);
    }
}

/* Returns the index of the lowest set bit, or 32 if there is none. */
static inline uint32_t lowest_bit(uint32_t bits) {
    uint32_t v = ~bits & (bits - 1); /* all bits below the lowest bit */
    v = v - (v >> 1 & 0x55555555u);
    v = (v & 0x33333333u) + (v >> 2 & 0x33333333u);
    return ((v + (v >> 4)) & 0x0f0f0f0fu) * 0x01010101u >> 24;
}

/* Finds the leaves or parts that remain after all tests of a group. The tests are independent of each other and need no branches. */
static void rule_out(const TreeEvidence *e, const L3Tree *tree, int group, uint32_t left[restrict TOGETHER]) {
    for (int i = 0; i < TOGETHER; i++) left[i] = UINT32_MAX;
    for (uint32_t t = tree->start[group]; t < tree->start[group + 1]; t++) {
        const float *restrict value = e->numerator[tree->numerator[t]], *restrict unit = e->denominator[tree->denominator[t]];
        const float threshold = tree->threshold[t];
        const uint32_t kept = ~tree->ruled_out[t];
        for (int i = 0; i < TOGETHER; i++) left[i] &= value[i] > threshold * unit[i] ? kept : UINT32_MAX;
    }
}

static void find_leaves(const TreeEvidence *e, const L3Tree *tree, uint32_t leaf[restrict TOGETHER]) {
    const int words = (tree->parts + 31) / 32;
    uint32_t left[TOGETHER], part[TOGETHER];
    for (int i = 0; i < TOGETHER; i++) part[i] = UINT32_MAX, leaf[i] = 0;
    for (int w = 0; w < words; w++) {
        rule_out(e, tree, w, left);
        for (int i = 0; i < TOGETHER; i++) {
            const uint32_t found = (32 * (uint32_t)w + lowest_bit(left[i])) | -(uint32_t)(left[i] == 0);
            part[i] = part[i] < found ? part[i] : found;
        }
    }
    for (uint32_t k = 0; k < (uint32_t)tree->parts; k++) {
        uint32_t some = 0;
        for (int i = 0; i < TOGETHER; i++) some |= part[i] == k;
        if (!some) continue;
        const uint32_t first = tree->first_leaf[k];
        rule_out(e, tree, words + (int)k, left);
        for (int i = 0; i < TOGETHER; i++) {
            const uint32_t its = -(uint32_t)(part[i] == k);
            leaf[i] = (leaf[i] & ~its) | ((first + lowest_bit(left[i])) & its);
        }
    }
}

/* Computes the classes of the row for which the sums were computed last. `first_labels` contains the classes of this row in the first
 * layer. The sums after the last column are undefined and not used. */
static void label_row(const Gradients *g, const L3PlaneLayer *layer, int k, int columns, const uint32_t *first_labels,
                      uint32_t *labels) {
    for (int x = 0; x < columns; x += TOGETHER) {
        const int width = smaller(TOGETHER, columns - x);
        TreeEvidence e;
        uint32_t leaf[TOGETHER];
        for (int i = 0; i < TOGETHER; i++) {
            const uint32_t word = layer->gradient[first_labels[smaller(x + i, columns - 1)]];
            e.transposed[i] = where(word, L3_TURN), e.across[i] = where(word, L3_TURN + 1), e.down[i] = where(word, L3_TURN + 2);
        }
        find_evidence(g, k, x, &e);
        find_leaves(&e, layer->tree, leaf);
        for (int i = 0; i < width; i++) labels[x + i] = plane_class(layer, first_labels[x + i], leaf[i]);
    }
}

static void label_by_tree(const Gradients *g, const L3PlaneLayer *layer, const int32_t *planes, const uint32_t *first_labels, int rows,
                          int columns, uint32_t *labels) {
    for (ptrdiff_t p = 0; p < L3_TESTS * g->span; p++) g->weighed[p] = 0;
    for (ptrdiff_t p = 0; p < QUANTITIES * WINDOW * g->span; p++) g->quantity[p] = 0;
    for (int k = 0; k < rows + 2 * REACH; k++) {
        for (int plane = 0; plane < 3; plane++) read_plane(g, planes, plane, k, rows, columns);
        if (k < 2) continue;
        read_scale(g, layer, first_labels, k - 1, rows, columns);
        plane_products(g, k, columns);
        if (k < 2 * REACH) continue;
        weigh_row(g, k, columns);
        const ptrdiff_t at = (ptrdiff_t)(k - 2 * REACH) * columns;
        label_row(g, layer, k, columns, first_labels + at, labels + at);
    }
}

