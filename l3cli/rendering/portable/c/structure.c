/* ------------------------------------------------------------------------------------------------ what later layers read */

#define REACH 3  /* pixels beyond a plane that the class at its edge reads */
#define WINDOW 5 /* rows of gradients that it weighs */
enum { XX, YY, XY, CHROMA_XX, CHROMA_YY, ALONG_FIRST, ALONG_SECOND, BEND_XX, BEND_YY, SLOPE_X, SLOPE_Y, BEND_X, BEND_Y, QUANTITIES };

/* Rows of what the classes of later layers decide by. Columns of planes have a margin of REACH pixels, those of gradients of
 * REACH - 1; rows lie in rings of WINDOW. */
typedef struct {
    ptrdiff_t span;      /* values of a row */
    int32_t *plane;      /* (plane, WINDOW, span) */
    int32_t *factor, *shift; /* (span) scale of the gradients of the latest row */
    int32_t *quantity;   /* (QUANTITIES, WINDOW, span) gradients of the latest rows, and products of them */
    int32_t *down;       /* (span) one of these, weighed over the rows */
    int32_t *weighed;    /* (L3_TESTS, span) such sums over whole windows */
    float *numerator;    /* (L3_TESTS, span) of a tree's tests */
    float *denominator;  /* (4, span) */
} Gradients;

static Gradients gradients_in(Room *room, int columns) {
    const uint64_t span = (uint64_t)columns + 2 * REACH;
    Gradients g;
    g.span = (ptrdiff_t)span;
    g.plane = take(room, span * 3 * WINDOW, sizeof *g.plane);
    g.factor = take(room, span, sizeof *g.factor);
    g.shift = take(room, span, sizeof *g.shift);
    g.quantity = take(room, span * QUANTITIES * WINDOW, sizeof *g.quantity);
    g.down = take(room, span, sizeof *g.down);
    g.weighed = take(room, span * L3_TESTS, sizeof *g.weighed);
    g.numerator = take(room, span * L3_TESTS, sizeof *g.numerator);
    g.denominator = take(room, span * 4, sizeof *g.denominator);
    return g;
}

static int32_t *plane_row(const Gradients *g, int plane, int k) { return g->plane + (plane * WINDOW + k % WINDOW) * g->span; }
static int32_t *quantity_row(const Gradients *g, int q, int k) { return g->quantity + (q * WINDOW + k % WINDOW) * g->span; }

/* What a class of the first layer says: its level, and its saturation case, 0 where no filter is lost. */
static uint32_t level_of(uint32_t label) { return label / (L3_CONTRASTS * L3_FURTHER * L3_KINDS) % L3_LEVELS; }
static uint32_t case_of(uint32_t label) {
    const uint32_t kind = label % L3_KINDS;
    return kind < L3_CHROMAS + L3_SPARED ? 0 : kind - L3_CHROMAS - L3_SPARED + 1;
}

/* Padded row k of a plane into its ring. */
static void read_plane(const Gradients *g, const int32_t *planes, int plane, int k, int rows, int columns) {
    const int32_t *restrict from = planes + ((ptrdiff_t)plane * rows + mirrored(k - REACH, rows, 1)) * columns;
    int32_t *restrict to = plane_row(g, plane, k);
    for (int c = 0; c < columns; c++) to[REACH + c] = from[c];
    for (int p = 0; p < REACH; p++) {
        to[p] = from[mirrored(p - REACH, columns, 1)];
        to[columns + REACH + p] = from[mirrored(columns + p, columns, 1)];
    }
}

/* Factor and shift of the gradients of padded row k, by the levels of the first layer. */
static void read_scale(const Gradients *g, const L3PlaneLayer *layer, const uint32_t *first_labels, int k, int rows, int columns) {
    const uint32_t *restrict from = first_labels + (ptrdiff_t)mirrored(k - REACH, rows, 1) * columns;
    for (int p = 0; p < columns + 2 * REACH - 2; p++) {
        const uint32_t level = level_of(from[mirrored_column(p - REACH + 1, columns)]);
        g->factor[p] = layer->gradient_factor[level];
        g->shift[p] = layer->gradient_shift[level];
    }
}

/* A difference of a plane's pixels in units of what noise makes of it, within a size of `top`. */
static inline int32_t scaled(int32_t difference, int32_t factor, int32_t shift, int32_t top) {
    const int32_t value = (difference * factor) >> shift, below = value < top ? value : top;
    return below > -top ? below : -top;
}

/* Sums of a quantity over 5 x 5, weights the products of 1 2 3 2 1; the rows end with k. */
static void weigh_wide(const Gradients *g, int q, int k, int columns, int32_t *restrict to) {
    const int32_t *restrict a = quantity_row(g, q, k - 4), *restrict b = quantity_row(g, q, k - 3);
    const int32_t *restrict c = quantity_row(g, q, k - 2), *restrict d = quantity_row(g, q, k - 1);
    const int32_t *restrict e = quantity_row(g, q, k);
    int32_t *restrict down = g->down;
    for (int p = 0; p < columns + 4; p++) down[p] = a[p] + 2 * b[p] + 3 * c[p] + 2 * d[p] + e[p];
    for (int x = 0; x < columns; x++) to[x] = down[x] + 2 * down[x + 1] + 3 * down[x + 2] + 2 * down[x + 3] + down[x + 4];
}

/* Sums over 3 x 3 from column x + `first` on, weights the products of 1 2 1, of three rows. */
static void weigh_near(const Gradients *g, const int32_t *restrict a, const int32_t *restrict b, const int32_t *restrict c, int first,
                       int columns, int32_t *restrict to) {
    int32_t *restrict down = g->down;
    for (int p = 0; p < columns + 2; p++) down[p] = a[p + first] + 2 * b[p + first] + c[p + first];
    for (int x = 0; x < columns; x++) to[x] = down[x] + 2 * down[x + 1] + down[x + 2];
}

/* The class of a pixel of a later layer from what its rule tells apart where nothing is saturated. */
static inline uint32_t plane_class(const L3PlaneLayer *layer, uint32_t first_label, uint32_t site, uint32_t structure) {
    const uint32_t saturation = case_of(first_label), level = level_of(first_label) / layer->level_step;
    const uint32_t kind = saturation > 0 ? layer->structures - 1 + saturation : structure;
    return (site * layer->levels + level) * layer->kinds + kind;
}

static uint32_t site_of(int y, int x, int phase_row, int phase_column) {
    return (uint32_t)((y + phase_row) % L3_CFA_ROWS * L3_CFA_COLUMNS + (x + phase_column) % L3_CFA_COLUMNS);
}

/* -------------------------------------------------------------------------------------------------------------- structure */

/* Gradients of luminance about padded row k - 1, and their products, as row k of the rings. */
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

/* Strength and direction of the edge at a pixel (README.md, "Structure") from its structure tensor. */
static inline uint32_t structure_of(const L3Structure *rule, int32_t xx, int32_t yy, int32_t xy, const int8_t *turn) {
    const int32_t a = ((xx - yy) >> 6) * turn[0], b = (xy >> 5) * turn[1];
    const uint32_t trace = (uint32_t)xx + (uint32_t)yy; /* up to 2^32, as what follows */
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
                               int rows, int columns, int phase_row, int phase_column, uint32_t *labels) {
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
            const uint32_t site = site_of(y, x, phase_row, phase_column);
            const uint32_t structure = structure_of(layer->structure, xx[x], yy[x], xy[x], layer->structure->turns + 2 * site);
            labels[at] = plane_class(layer, first_labels[at], site, structure);
        }
    }
}

