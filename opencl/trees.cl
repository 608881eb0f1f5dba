// Processor variant: planes and classes of the layer before → classes of the next, by a tree.
//
// One work-item labels a tile of TILE columns and BAND rows, row after row. Gradients and bends of the latest five rows are kept;
// sums are separable: weighed down the columns, then across.

#define STRUCTURE_CONSTANTS LABEL_CONSTANTS, __global const uint *restrict tests
#define ROWS 5       // of gradients
#define PLANE_ROWS 5
#define REACHED (TILE + 2 * STRUCTURE_REACH + 4 * LANES)

typedef struct {
    int xx[REACHED], yy[REACHED], xy[REACHED], chroma_xx[REACHED], chroma_yy[REACHED], u_along[REACHED], v_along[REACHED];
    int slope_x[REACHED], slope_y[REACHED], bend_x[REACHED], bend_y[REACHED];
} Products;

typedef struct {
    int u[REACHED], luminance[REACHED], v[REACHED];
} Planes;

// Weighed down the columns: products over five rows, and over the three in their middle.
typedef struct {
    int xx[REACHED], yy[REACHED], xy[REACHED], chroma_xx[REACHED], chroma_yy[REACHED], u_along[REACHED], v_along[REACHED];
    int near[REACHED], bend_xx[REACHED], bend_yy[REACHED], slope_x[REACHED], slope_y[REACHED];
    int u[REACHED], v[REACHED], luminance[REACHED];
} Columns;

// A padded row of the planes and of what its pixels' classes say of gradients.
INLINE void read_row(Planes *to, uint *scale, __global const int *planes, size_t stride, __global const uint *labels,
                     __global const int *column_source, __global const uint *label_gradient, int x0, int columns) {
    const int end = min(TILE, columns - x0) + 2 * STRUCTURE_REACH;
    #pragma clang loop vectorize(disable) unroll_count(4)
    for (int p = 0; p < end; p++) {
        const int x = column_source[x0 + p];
        to->u[p] = planes[x];
        to->luminance[p] = planes[stride + x];
        to->v[p] = planes[2 * stride + x];
        scale[p] = label_gradient[labels[x]];
    }
}

#define AT(row, p) LOAD_PRIVATE(ints, (row) + (p))
#define PUT(row, p) STORE_PRIVATE(ints, (row) + (p))
#define ACROSS_OF(plane, top) gradient(AT(here->plane, p + 1) - AT(here->plane, p - 1), scale, top)
#define DOWN_OF(plane, top) gradient(AT(below->plane, p) - AT(above->plane, p), scale, top)

INLINE void multiply(Products *to, const Planes *above, const Planes *here, const Planes *below, const uint *scales, int span) {
    for (int p = 1; p < span; p += LANES) {
        const uints scale = LOAD_PRIVATE(uints, scales + p);
        const ints gx = ACROSS_OF(luminance, GRADIENT_TOP), gy = DOWN_OF(luminance, GRADIENT_TOP);
        const ints ux = ACROSS_OF(u, CHROMA_TOP), uy = DOWN_OF(u, CHROMA_TOP);
        const ints vx = ACROSS_OF(v, CHROMA_TOP), vy = DOWN_OF(v, CHROMA_TOP), twice = 2 * AT(here->luminance, p);
        PUT(to->xx, p) = gx * gx;
        PUT(to->yy, p) = gy * gy;
        PUT(to->xy, p) = gx * gy;
        PUT(to->chroma_xx, p) = ux * ux + vx * vx;
        PUT(to->chroma_yy, p) = uy * uy + vy * vy;
        PUT(to->u_along, p) = gx * ux + gy * uy;
        PUT(to->v_along, p) = gx * vx + gy * vy;
        PUT(to->slope_x, p) = gx;
        PUT(to->slope_y, p) = gy;
        PUT(to->bend_x, p) = gradient(AT(here->luminance, p - 1) - twice + AT(here->luminance, p + 1), scale, GRADIENT_TOP);
        PUT(to->bend_y, p) = gradient(AT(above->luminance, p) - twice + AT(below->luminance, p), scale, GRADIENT_TOP);
    }
}

#define FIVE_OF(f) (f(0) + 2 * f(1) + 3 * f(2) + 2 * f(3) + f(4))
#define THREE_OF(f) (f(1) + 2 * f(2) + f(3))

// Rows r[0] to r[4] of products and, about the same one, q[1] to q[3] of planes.
INLINE void weigh_rows(Columns *to, const Products *r[ROWS], const Planes *q[PLANE_ROWS], int span) {
    for (int p = 1; p < span; p += LANES) {
#define WIDE_ROWS(name) { const ints one = AT(r[0]->name, p) + AT(r[4]->name, p), two = AT(r[1]->name, p) + AT(r[3]->name, p); \
                          PUT(to->name, p) = one + 2 * two + 3 * AT(r[2]->name, p); }
        WIDE_ROWS(xx) WIDE_ROWS(yy) WIDE_ROWS(xy) WIDE_ROWS(chroma_xx) WIDE_ROWS(chroma_yy) WIDE_ROWS(u_along) WIDE_ROWS(v_along)
#define ENERGY(i) (AT(r[i]->xx, p) + AT(r[i]->yy, p))
#define BEND_X(i) (AT(r[i]->bend_x, p) * AT(r[i]->bend_x, p))
#define BEND_Y(i) (AT(r[i]->bend_y, p) * AT(r[i]->bend_y, p))
#define SLOPE_X(i) AT(r[i]->slope_x, p)
#define SLOPE_Y(i) AT(r[i]->slope_y, p)
#define PLANE_U(i) AT(q[i]->u, p)
#define PLANE_V(i) AT(q[i]->v, p)
#define PLANE_L(i) AT(q[i]->luminance, p)
        PUT(to->near, p) = THREE_OF(ENERGY);
        PUT(to->bend_xx, p) = THREE_OF(BEND_X);
        PUT(to->bend_yy, p) = THREE_OF(BEND_Y);
        PUT(to->slope_x, p) = THREE_OF(SLOPE_X);
        PUT(to->slope_y, p) = THREE_OF(SLOPE_Y);
        PUT(to->u, p) = THREE_OF(PLANE_U);
        PUT(to->v, p) = THREE_OF(PLANE_V);
        PUT(to->luminance, p) = THREE_OF(PLANE_L);
    }
}

// Weighed across the columns from `at` on, and the three in their middle.
INLINE ints wide(const int *at) { return AT(at, 0) + AT(at, 4) + 2 * (AT(at, 1) + AT(at, 3)) + 3 * AT(at, 2); }
INLINE ints narrow(const int *at) { return AT(at, 1) + AT(at, 3) + 2 * AT(at, 2); }

INLINE void look(Evidence *e, const Columns *c, const Products *middle, uints turns, int p) {
    Sums sums = {
        wide(c->xx + p), wide(c->yy + p), wide(c->xy + p), wide(c->chroma_xx + p), wide(c->chroma_yy + p), wide(c->u_along + p),
        wide(c->v_along + p), narrow(c->near + p), narrow(c->bend_xx + p), narrow(c->bend_yy + p), narrow(c->slope_x + p),
        narrow(c->slope_y + p), narrow(c->u + p), narrow(c->v + p), narrow(c->luminance + p),
        AT(middle->bend_x, p + 2), AT(middle->bend_y, p + 2)};
    turn(&sums, turns);
    weigh(e, &sums);
}

// All tests of a tree are made of all pixels, without a branch: leaves are numbered from left to right, a test that is passed
// rules out those below its first branch, and of the leaves that are left at the end the first is the pixel's. A test is three
// words: the bits of its threshold; its numerator, from bit 6 on its denominator, from bit 8 on which 32 leaves it is about; and
// those of them that it rules out. Products and comparisons of float32 are the same on every device.
#define WORDS ((LEAVES + 31) / 32)

INLINE void rule_out(uints alive[WORDS], const Evidence *e, __global const uint *tests) {
    for (int w = 0; w < WORDS; w++) alive[w] = (uints)0xffffffffu;
    for (int t = 0; t < RULED_OUT; t++) {
        const uint asked = tests[3 * t + 1];
        const ints passed = e->numerator[asked & 0x3f] > as_float(tests[3 * t]) * e->denominator[asked >> 6 & 3];
        alive[asked >> 8] &= ~(SAME_BITS(passed, uints) & tests[3 * t + 2]);
    }
}

// Leaves of LANES pixels.
INLINE void leaves_of(uint *leaf, const uints alive[WORDS]) {
    uints bits = alive[WORDS - 1], base = (uints)(32 * (WORDS - 1));
    for (int w = WORDS - 2; w >= 0; w--) {
        base = alive[w] != 0 ? (uints)(32 * w) : base;
        bits = alive[w] != 0 ? alive[w] : bits;
    }
    const uints lowest = bits & -bits;  // that one alone, whose number a float's exponent tells
    const floats power = CONVERT(lowest >> 1, floats) * 2.0f + CONVERT(lowest & 1, floats);
    const uints number = (SAME_BITS(power, uints) >> 23) - 127;
    STORE_PRIVATE(uints, leaf) = base + number;
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void structures(STRUCTURES_PARAMETERS) {
    const int x0 = get_group_id(0) * TILE, y0 = get_group_id(1) * BAND;
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0), span = width + 2 * STRUCTURE_REACH;
    const size_t stride = (size_t)source_rows * columns;
    Planes plane_rows[PLANE_ROWS];
    Products product_rows[ROWS];
    Columns sums;
    Evidence evidence;
    uint scale[2][REACHED];
    for (int i = 0; i < PLANE_ROWS; i++)
        for (int p = 0; p < REACHED; p++) plane_rows[i].u[p] = plane_rows[i].luminance[p] = plane_rows[i].v[p] = 0;
    for (int p = 0; p < REACHED; p++) scale[0][p] = scale[1][p] = 0;
    for (int k = 0; k < y1 - y0 + 2 * STRUCTURE_REACH; k++) {
        read_row(plane_rows + k % PLANE_ROWS, scale[k % 2], planes + (size_t)row_source[y0 + k] * columns, stride,
                 first_labels + (size_t)label_source[y0 + k] * columns, column_source, label_gradient, x0, columns);
        if (k < 2) continue;
        multiply(product_rows + k % ROWS, plane_rows + (k - 2) % PLANE_ROWS, plane_rows + (k - 1) % PLANE_ROWS,
                 plane_rows + k % PLANE_ROWS, scale[(k - 1) % 2], span);
        if (k < 2 * STRUCTURE_REACH) continue;
        const Products *r[ROWS];
        const Planes *q[PLANE_ROWS];
        for (int i = 0; i < ROWS; i++) r[i] = product_rows + (k - 4 + i) % ROWS;       // about padded row k - 3
        for (int i = 1; i < 4; i++) q[i] = plane_rows + (k - 5 + i) % PLANE_ROWS;
        weigh_rows(&sums, r, q, span);
        const int y = y0 + k - 2 * STRUCTURE_REACH;
        __global const uint *before = first_labels + (size_t)label_source[y + STRUCTURE_REACH] * columns + x0;
        __global uint *label_row = labels + (size_t)y * columns + x0;
        for (int x = 0; x < width; x += LANES) {
            uint turns[LANES], start[LANES], leaf[LANES];
            #pragma clang loop vectorize(disable)
            for (int i = 0; i < LANES; i++) {
                const uint label = before[x + i < width ? x + i : 0];
                turns[i] = label_gradient[label];
                start[i] = label_start[label];
            }
            uints alive[WORDS];
            look(&evidence, &sums, r[2], LOAD_PRIVATE(uints, turns), x + 1);
            rule_out(alive, &evidence, tests);
            leaves_of(leaf, alive);
            for (int i = 0; i < LANES && x + i < width; i++)
                label_row[x + i] = FIRST_CLASS(start[i]) + (DECIDED(start[i]) ? 0 : leaf[i]);
        }
    }
}
