/* ------------------------------------------------------------------------------------------- gradients of the planes */

#define REACH 3  /* number of pixels outside the frame that influence the class of a pixel at the edge */
#define WINDOW 5 /* number of rows of gradients that influence a class */
#define TOGETHER 32 /* number of pixels for which a tree is evaluated at the same time */
enum {
    XX, YY, XY, CHROMA_XX, CHROMA_YY, ALONG_FIRST, ALONG_SECOND, CHROMA_BEND_XX, CHROMA_BEND_YY,
    BEND_XX, BEND_YY, SLOPE_X, SLOPE_Y, BEND_X, BEND_Y, QUANTITIES
};

/* Rows of the quantities from which the classes of later layers are computed. Rows of planes have a margin of REACH pixels on each side,
 * and rows of gradients a margin of REACH - 1. The latest WINDOW rows are stored in rings. */
typedef struct {
    ptrdiff_t span;      /* length of a row */
    int32_t *plane;      /* (plane, WINDOW, span) */
    int32_t *factor, *shift; /* (span) scale of the gradients of the latest row */
    int32_t *quantity;   /* (QUANTITIES, WINDOW, span) gradients of the latest rows, and their products */
    int32_t *down;       /* (span) weighted sum of a quantity over the rows of the window */
    int32_t *weighed;    /* (L3_TESTS, span) weighted sums over whole windows */
} Gradients;

static Gradients gradients_in(Room *room, int columns) {
    const uint64_t span = ((uint64_t)columns + TOGETHER - 1) / TOGETHER * TOGETHER + 2 * REACH;
    Gradients g;
    g.span = (ptrdiff_t)span;
    g.plane = take(room, span * 3 * WINDOW, sizeof *g.plane);
    g.factor = take(room, span, sizeof *g.factor);
    g.shift = take(room, span, sizeof *g.shift);
    g.quantity = take(room, span * QUANTITIES * WINDOW, sizeof *g.quantity);
    g.down = take(room, span, sizeof *g.down);
    g.weighed = take(room, span * L3_TESTS, sizeof *g.weighed);
    return g;
}

static int32_t *plane_row(const Gradients *g, int plane, int k) { return g->plane + (plane * WINDOW + k % WINDOW) * g->span; }
static int32_t *quantity_row(const Gradients *g, int q, int k) { return g->quantity + (q * WINDOW + k % WINDOW) * g->span; }

/* Copies padded row k of a plane to its ring. */
static void read_plane(const Gradients *g, const int32_t *planes, int plane, int k, int rows, int columns) {
    const int32_t *restrict from = planes + ((ptrdiff_t)plane * rows + mirrored(k - REACH, rows, 1)) * columns;
    int32_t *restrict to = plane_row(g, plane, k);
    for (int c = 0; c < columns; c++) to[REACH + c] = from[c];
    for (int p = 0; p < REACH; p++) {
        to[p] = from[mirrored(p - REACH, columns, 1)];
        to[columns + REACH + p] = from[mirrored(columns + p, columns, 1)];
    }
}

/* Finds factor and shift of the gradients of padded row k from the classes of the first layer. */
static void read_scale(const Gradients *g, const L3PlaneLayer *layer, const uint32_t *first_labels, int k, int rows, int columns) {
    const uint32_t *restrict from = first_labels + (ptrdiff_t)mirrored(k - REACH, rows, 1) * columns;
    int32_t *restrict factor = g->factor, *restrict shift = g->shift;
    for (int p = 0; p < columns + 2 * REACH - 2; p++) {
        const uint32_t word = layer->gradient[from[mirrored_column(p - REACH + 1, columns)]];
        factor[p] = (int32_t)(word & 0xff);
        shift[p] = (int32_t)(word >> 8 & 0x1f);
    }
}

/* Converts the difference of two pixels in a plane to multiples of its noise, limited to +-top. */
static inline int32_t scaled(int32_t difference, int32_t factor, int32_t shift, int32_t top) {
    const int32_t value = (difference * factor) >> shift, below = value < top ? value : top;
    return below > -top ? below : -top;
}

/* Computes weighted sums of a quantity over 5 x 5 pixels, with the weights 1 2 3 2 1 in both directions. The last row is k. */
static void weigh_wide(const Gradients *g, int q, int k, int columns, int32_t *restrict to) {
    const int32_t *restrict a = quantity_row(g, q, k - 4), *restrict b = quantity_row(g, q, k - 3);
    const int32_t *restrict c = quantity_row(g, q, k - 2), *restrict d = quantity_row(g, q, k - 1);
    const int32_t *restrict e = quantity_row(g, q, k);
    int32_t *restrict down = g->down;
    for (int p = 0; p < columns + 4; p++) down[p] = a[p] + 2 * b[p] + 3 * c[p] + 2 * d[p] + e[p];
    for (int x = 0; x < columns; x++) to[x] = down[x] + 2 * down[x + 1] + 3 * down[x + 2] + 2 * down[x + 3] + down[x + 4];
}

/* Computes weighted sums over 3 x 3 pixels of the rows a, b and c, with the weights 1 2 1 in both directions. The first column is x + first. */
static void weigh_near(const Gradients *g, const int32_t *restrict a, const int32_t *restrict b, const int32_t *restrict c, int first,
                       int columns, int32_t *restrict to) {
    int32_t *restrict down = g->down;
    for (int p = 0; p < columns + 2; p++) down[p] = a[p + first] + 2 * b[p + first] + c[p + first];
    for (int x = 0; x < columns; x++) to[x] = down[x] + 2 * down[x + 1] + down[x + 2];
}

/* Returns all bits if a bit of a word in `gradient` is set (see L3PlaneLayer in l3_table.h), otherwise 0. */
static inline int32_t where(uint32_t word, int bit) { return -(int32_t)(word >> bit & 1); }
static inline int32_t negated(int32_t value, int32_t mask) { return (value ^ mask) - mask; }

/* Returns the class of a pixel in a later layer. `structure` is its structure or leaf, which is used unless a pixel nearby is saturated. */
static inline uint32_t plane_class(const L3PlaneLayer *layer, uint32_t first_label, uint32_t structure) {
    const uint32_t first = layer->first_class[first_label];
    return first & L3_DECIDED ? first - L3_DECIDED : first + structure;
}

/* -------------------------------------------------------------------------------------------------------------- structure */

/* Computes the products of the luminance gradients at padded row k - 1, and stores them as row k of the rings. */
static void luminance_products(const Gradients *g, int k, int columns) {
    const int32_t *restrict above = plane_row(g, L3_LUMINANCE, k - 2), *restrict here = plane_row(g, L3_LUMINANCE, k - 1);
    const int32_t *restrict below = plane_row(g, L3_LUMINANCE, k), *restrict factor = g->factor, *restrict shift = g->shift;
    int32_t *restrict xx = quantity_row(g, XX, k), *restrict yy = quantity_row(g, YY, k), *restrict xy = quantity_row(g, XY, k);
    for (int p = 0; p < columns + 4; p++) {
        const int32_t gx = scaled(here[p + 2] - here[p], factor[p], shift[p], L3_GRADIENT_TOP);
        const int32_t gy = scaled(below[p + 1] - above[p + 1], factor[p], shift[p], L3_GRADIENT_TOP);
        xx[p] = gx * gx, yy[p] = gy * gy, xy[p] = gx * gy;
    }
}

/* Computes strength and direction of the edge at a pixel from the structure tensor (see "Structure" in README.md). */
static inline uint32_t structure_of(const L3Structure *rule, int32_t xx, int32_t yy, int32_t xy, uint32_t word) {
    const int32_t a = negated((xx - yy) >> 6, where(word, L3_TURN)), b = negated(xy >> 5, where(word, L3_TURN + 1));
    const uint32_t trace = (uint32_t)xx + (uint32_t)yy; /* unsigned, like the following values, because it can exceed 2^31 */
    const uint32_t width = (uint32_t)(a < 0 ? -a : a), height = (uint32_t)(b < 0 ? -b : b);
    uint32_t strength = 0, direction = b > 0 ? (a > 0 ? 1u : 3u) : (a > 0 ? 7u : 5u);
    for (int s = 0; s < rule->strengths; s++) strength += trace > rule->strength_edges[s];
    if (strength == 0) return 0;
    uint32_t along = ((width + height) * 45) >> 6;
    if (12 * height < 5 * width) direction = a > 0 ? 0 : 4, along = width;
    else if (12 * width < 5 * height) direction = b > 0 ? 2 : 6, along = height;
    const uint32_t within = 64 * along > rule->coherence * (trace >> 6) ? 1 + direction : 0;
    return 1 + (strength - 1) * 9 + within;
}

static void label_by_structure(const Gradients *g, const L3PlaneLayer *layer, const int32_t *planes, const uint32_t *first_labels,
                               int rows, int columns, uint32_t *labels) {
    int32_t *xx = g->weighed, *yy = xx + g->span, *xy = yy + g->span;
    for (int k = 0; k < rows + 2 * REACH; k++) {
        read_plane(g, planes, L3_LUMINANCE, k, rows, columns);
        if (k < 2) continue;
        read_scale(g, layer, first_labels, k - 1, rows, columns);
        luminance_products(g, k, columns);
        if (k < 2 * REACH) continue;
        weigh_wide(g, XX, k, columns, xx), weigh_wide(g, YY, k, columns, yy), weigh_wide(g, XY, k, columns, xy);
        const int y = k - 2 * REACH;
        for (int x = 0; x < columns; x++) {
            const ptrdiff_t at = (ptrdiff_t)y * columns + x;
            const uint32_t word = layer->gradient[first_labels[at]];
            labels[at] = plane_class(layer, first_labels[at], structure_of(layer->structure, xx[x], yy[x], xy[x], word));
        }
    }
}

