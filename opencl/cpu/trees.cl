// Processor variant: computes the classes of a refinement layer with a decision tree, from its planes and the classes of the first layer.
//
// Each work-item processes one tile of TILE columns and BAND rows, row by row, and stores the first and second differences of the latest five
// rows. Weighted sums are separable: they are computed over the rows, and then over the columns.

#define STRUCTURE_CONSTANTS LABEL_CONSTANTS, __global const uint *restrict tests
#define STRUCTURE_READ label_words, tests
#define ROWS 5  // stored rows of gradients
#define PLANE_ROWS 5

typedef struct {
    int xx[REACHED], yy[REACHED], xy[REACHED], chroma_xx[REACHED], chroma_yy[REACHED], u_along[REACHED], v_along[REACHED];
    int chroma_bend_xx[REACHED], chroma_bend_yy[REACHED], slope_x[REACHED], slope_y[REACHED], bend_x[REACHED], bend_y[REACHED];
} Products;

typedef struct {
    int u[REACHED], luminance[REACHED], v[REACHED];
} Planes;

// Weighted sums over rows: products over five rows or the middle three, and planes over three rows.
typedef struct {
    int xx[REACHED], yy[REACHED], xy[REACHED], chroma_xx[REACHED], chroma_yy[REACHED], u_along[REACHED], v_along[REACHED];
    int chroma_bend_xx[REACHED], chroma_bend_yy[REACHED], narrow_strength[REACHED], bend_xx[REACHED], bend_yy[REACHED], slope_x[REACHED], slope_y[REACHED];
    int u[REACHED], v[REACHED], luminance[REACHED];
} Columns;

#define AT(row, p) LOAD_PRIVATE(ints, (row) + (p))
#define PUT(row, p) STORE_PRIVATE(ints, (row) + (p))
#define ACROSS_OF(plane, top) gradient(AT(middle->plane, p + 1) - AT(middle->plane, p - 1), scale, top)
#define DOWN_OF(plane, top) gradient(AT(below->plane, p) - AT(above->plane, p), scale, top)
#define BEND_ACROSS_OF(plane, top) gradient(AT(middle->plane, p - 1) - 2 * AT(middle->plane, p) + AT(middle->plane, p + 1), scale, top)
#define BEND_DOWN_OF(plane, top) gradient(AT(above->plane, p) - 2 * AT(middle->plane, p) + AT(below->plane, p), scale, top)

INLINE void multiply(Products *to, const Planes *above, const Planes *middle, const Planes *below, const Words *words, int span) {
    for (int p = 1; p < span; p += LANES) {
        const uints scale = gradient_words(words, p);
        const ints gx = ACROSS_OF(luminance, GRADIENT_TOP), gy = DOWN_OF(luminance, GRADIENT_TOP);
        const ints ux = ACROSS_OF(u, CHROMA_TOP), uy = DOWN_OF(u, CHROMA_TOP);
        const ints vx = ACROSS_OF(v, CHROMA_TOP), vy = DOWN_OF(v, CHROMA_TOP);
        const ints ubx = BEND_ACROSS_OF(u, CHROMA_TOP), uby = BEND_DOWN_OF(u, CHROMA_TOP);
        const ints vbx = BEND_ACROSS_OF(v, CHROMA_TOP), vby = BEND_DOWN_OF(v, CHROMA_TOP);
        PUT(to->xx, p) = gx * gx;
        PUT(to->yy, p) = gy * gy;
        PUT(to->xy, p) = gx * gy;
        PUT(to->chroma_xx, p) = ux * ux + vx * vx;
        PUT(to->chroma_yy, p) = uy * uy + vy * vy;
        PUT(to->u_along, p) = gx * ux + gy * uy;
        PUT(to->v_along, p) = gx * vx + gy * vy;
        if (SLOPES_USED) {
            PUT(to->slope_x, p) = gx;
            PUT(to->slope_y, p) = gy;
        }
        if (CHROMA_BENDS_USED) {
            PUT(to->chroma_bend_xx, p) = ubx * ubx + vbx * vbx;
            PUT(to->chroma_bend_yy, p) = uby * uby + vby * vby;
        }
        PUT(to->bend_x, p) = BEND_ACROSS_OF(luminance, GRADIENT_TOP);
        PUT(to->bend_y, p) = BEND_DOWN_OF(luminance, GRADIENT_TOP);
    }
}

#define FIVE_OF(f) (f(0) + 2 * f(1) + 3 * f(2) + 2 * f(3) + f(4))
#define THREE_OF(f) (f(1) + 2 * f(2) + f(3))

// Computes weighted sums over the product rows r[0] to r[4] and the plane rows q[1] to q[3]. r[2] and q[2] are the same image row.
INLINE void weigh_rows(Columns *to, const Products *r[ROWS], const Planes *q[PLANE_ROWS], int span) {
    for (int p = 1; p < span; p += LANES) {
#define WIDE_ROWS(name) { const ints one = AT(r[0]->name, p) + AT(r[4]->name, p), two = AT(r[1]->name, p) + AT(r[3]->name, p); \
                          PUT(to->name, p) = one + 2 * two + 3 * AT(r[2]->name, p); }
        WIDE_ROWS(xx) WIDE_ROWS(yy) WIDE_ROWS(xy) WIDE_ROWS(chroma_xx) WIDE_ROWS(chroma_yy) WIDE_ROWS(u_along) WIDE_ROWS(v_along)
        if (CHROMA_BENDS_USED) { WIDE_ROWS(chroma_bend_xx) WIDE_ROWS(chroma_bend_yy) }
#define ENERGY(i) (AT(r[i]->xx, p) + AT(r[i]->yy, p))
#define BEND_X(i) (AT(r[i]->bend_x, p) * AT(r[i]->bend_x, p))
#define BEND_Y(i) (AT(r[i]->bend_y, p) * AT(r[i]->bend_y, p))
#define SLOPE_X(i) AT(r[i]->slope_x, p)
#define SLOPE_Y(i) AT(r[i]->slope_y, p)
#define PLANE_U(i) AT(q[i]->u, p)
#define PLANE_V(i) AT(q[i]->v, p)
#define PLANE_L(i) AT(q[i]->luminance, p)
        PUT(to->narrow_strength, p) = THREE_OF(ENERGY);
        PUT(to->bend_xx, p) = THREE_OF(BEND_X);
        PUT(to->bend_yy, p) = THREE_OF(BEND_Y);
        if (SLOPES_USED) {
            PUT(to->slope_x, p) = THREE_OF(SLOPE_X);
            PUT(to->slope_y, p) = THREE_OF(SLOPE_Y);
        }
        PUT(to->u, p) = THREE_OF(PLANE_U);
        PUT(to->v, p) = THREE_OF(PLANE_V);
        PUT(to->luminance, p) = THREE_OF(PLANE_L);
    }
}

// Weighted sums over the five columns that start at `at` (wide), and over the three columns in the middle of these (narrow).
INLINE ints wide(const int *at) { return AT(at, 0) + AT(at, 4) + 2 * (AT(at, 1) + AT(at, 3)) + 3 * AT(at, 2); }
INLINE ints narrow(const int *at) { return AT(at, 1) + AT(at, 3) + 2 * AT(at, 2); }

INLINE void look(Evidence *e, const Columns *c, const Products *middle, uints turns, int p) {
    Sums sums = {
        wide(c->xx + p), wide(c->yy + p), wide(c->xy + p), wide(c->chroma_xx + p), wide(c->chroma_yy + p), wide(c->u_along + p),
        wide(c->v_along + p), wide(c->chroma_bend_xx + p), wide(c->chroma_bend_yy + p), narrow(c->narrow_strength + p), narrow(c->bend_xx + p), narrow(c->bend_yy + p), narrow(c->slope_x + p),
        narrow(c->slope_y + p), narrow(c->u + p), narrow(c->v + p), narrow(c->luminance + p),
        AT(middle->bend_x, p + 2), AT(middle->bend_y, p + 2)};
    turn(&sums, turns);
    weigh(e, &sums);
}

// The tree is split into PARTS subtrees (parts) of at most 32 leaves. The kernel first finds the part of each pixel, and then evaluates only the
// parts that occur. Within a part, all tests are applied to all pixels, without branches. Leaves are numbered from left to right. If a pixel
// passes a test, the leaves below the test's first branch are excluded. The pixel's leaf is the first one that remains. Parts are found in the
// same way, 32 at a time.
//
// `tests` contains these arrays, one after another:
// 1. the index of the first test of each group of 32 parts
// 2. the index of the first test within each part, and the end of the last test
// 3. the first leaf of each part
// 4. the tests
// A test has three words: the bits of its threshold, the indices of its numerator and (from bit 8) its denominator, and a mask of the leaves
// or parts that it excludes. Tests use only products and comparisons in float32, so every device finds the same leaf.
#define WORDS ((PARTS + 31) / 32)
#define AT_ONCE 2  // vectors of pixels that are processed together, so that each test is read once for all of them

// Returns the index of the lowest set bit.
INLINE uints lowest_bit(uints bits) {
    const uints lowest = bits & -bits;  // only the lowest bit; its number is the exponent of the float
    const floats power = CONVERT(lowest >> 1, floats) * 2.0f + CONVERT(lowest & 1, floats);
    return (SAME_BITS(power, uints) >> 23) - 127;
}

INLINE bool some(ints mask) {
    ulong word[LANES / 8], all = 0;
    *(signed_chars_unaligned *)word = CONVERT(mask, signed_chars);
    #pragma unroll
    for (int i = 0; i < LANES / 8; i++) all |= word[i];
    return all != 0;
}

// Applies a group of tests to leaves or parts. In `left`, a bit is set for each of them that no test excludes.
INLINE void rule_out(uints left[AT_ONCE], const Evidence e[AT_ONCE], __global const uint *tests, int group) {
    for (int i = 0; i < AT_ONCE; i++) left[i] = (uints)0xffffffffu;
    for (uint t = tests[group]; t < tests[group + 1]; t += 3) {
        const float threshold = as_float(tests[t]);
        const uint asked = tests[t + 1], ruled_out = tests[t + 2];
        #pragma unroll
        for (int i = 0; i < AT_ONCE; i++) {
            const ints passed = e[i].numerator[asked & 0xff] > threshold * e[i].denominator[asked >> 8];
            left[i] = passed ? left[i] & ~ruled_out : left[i];
        }
    }
}

INLINE void leaves_of(uints leaf[AT_ONCE], const Evidence e[AT_ONCE], __global const uint *tests) {
    __global const uint *first_leaf = tests + WORDS + PARTS + 1;
    uints part[AT_ONCE], left[AT_ONCE];
    ints undecided[AT_ONCE];
    for (int i = 0; i < AT_ONCE; i++) {
        leaf[i] = part[i] = (uints)0;
        undecided[i] = (ints)-1;
    }
    for (int w = 0; w < WORDS && some(undecided[0] | undecided[1]); w++) {
        rule_out(left, e, tests, w);
        #pragma unroll
        for (int i = 0; i < AT_ONCE; i++) {
            part[i] = undecided[i] ? 32 * w + lowest_bit(left[i]) : part[i];
            undecided[i] &= left[i] == 0;
        }
    }
    for (int k = 0; k < PARTS; k++) {
        const uints number = (uint)k;
        if (!some((part[0] == number) | (part[1] == number))) continue;
        rule_out(left, e, tests, WORDS + k);
        #pragma unroll
        for (int i = 0; i < AT_ONCE; i++) leaf[i] = part[i] == number ? first_leaf[k] + lowest_bit(left[i]) : leaf[i];
    }
}

#ifndef TRANSFORM_ONLY  // another program contains this kernel if TRANSFORM_ONLY is set
COMPILED_ONCE structures_of_tile(int x0, int y0, STRUCTURES_PARAMETERS) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0), span = width + 2 * STRUCTURE_REACH;
    const size_t stride = (size_t)source_rows * columns;
    Planes plane_rows[PLANE_ROWS];
    Products product_rows[ROWS];
    Columns sums;
    Evidence evidence[AT_ONCE];
    Words words[4];
    for (int i = 0; i < PLANE_ROWS; i++)
        for (int p = 0; p < REACHED; p++) plane_rows[i].u[p] = plane_rows[i].luminance[p] = plane_rows[i].v[p] = 0;
    for (int i = 0; i < 4; i++)
        for (int p = 0; p < REACHED; p++) words[i].of[p] = 0;
    for (int k = 0; k < y1 - y0 + 2 * STRUCTURE_REACH; k++) {
        __global const int *row = planes + (size_t)row_source[y0 + k] * columns;
        Planes *entering = plane_rows + k % PLANE_ROWS;
        read_plane(entering->u, row, column_source, x0, span, columns);
        read_plane(entering->luminance, row + stride, column_source, x0, span, columns);
        read_plane(entering->v, row + 2 * stride, column_source, x0, span, columns);
        read_words(words + k % 4, first_labels + (size_t)label_source[y0 + k] * columns, column_source, label_words, x0, span,
                   columns);
        if (k < 2) continue;
        multiply(product_rows + k % ROWS, plane_rows + (k - 2) % PLANE_ROWS, plane_rows + (k - 1) % PLANE_ROWS, entering,
                 words + (k - 1) % 4, span);
        if (k < 2 * STRUCTURE_REACH) continue;
        const Products *r[ROWS];
        const Planes *q[PLANE_ROWS];
        for (int i = 0; i < ROWS; i++) r[i] = product_rows + (k - 4 + i) % ROWS;       // the middle row is padded row k - 3
        for (int i = 1; i < 4; i++) q[i] = plane_rows + (k - 5 + i) % PLANE_ROWS;
        weigh_rows(&sums, r, q, span);
        const Words *middle = words + (k - STRUCTURE_REACH) % 4;
        __global uint *label_row = labels + (size_t)(y0 + k - 2 * STRUCTURE_REACH) * columns + x0;
        for (int x = 0; x < width; x += AT_ONCE * LANES) {
            uints leaf[AT_ONCE];
            for (int i = 0; i < AT_ONCE; i++) {
                const int p = x + i * LANES;
                look(evidence + i, &sums, r[2], gradient_words(middle, p + STRUCTURE_REACH), p + 1);
            }
            leaves_of(leaf, evidence, tests);
            for (int i = 0; i < AT_ONCE; i++) {
                const uints first = start_words(middle, x + i * LANES + STRUCTURE_REACH);
                const uints label = DECIDED(first) != 0 ? FIRST_CLASS(first) : first + leaf[i];
                write_labels(label_row, label, x + i * LANES, width);
            }
        }
    }
}

KERNEL_OF_ONE structures(STRUCTURES_PARAMETERS) { structures_of_tile(GROUP_COLUMN, GROUP_ROW, STRUCTURES_READ); }
#endif
