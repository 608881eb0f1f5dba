// Computes the class of each pixel from sums over its patch, on CPUs and GPUs. A call processes as many pixels as `uints` has lanes. Features are
// combined as in ClassRule and l3cli/classes/decide.py. Unsigned arithmetic may wrap around, but the results are exact.

// CFA phase of padded row or column p. This is row or column p - RADIUS of the frame, which begins at the phase `start`.
#define PADDED_PHASE(p, start, period) (((p) + (start) + ((period) - 1) * RADIUS) % (period))

// Constants of the features, in the order of l3cli/classes/plane_kernel.py. The first macro declares parameters, the second one passes arguments.
#define BASIC_CONSTANTS LEVEL_CONSTANTS, CONTRAST_CONSTANTS, SATURATION_CONSTANTS, CHROMA_CONSTANTS
#define BASIC level_tops, contrast_edges, case_of_code, chroma_weights
#ifdef EACH_WINDOW
#define RULE_CONSTANTS BASIC_CONSTANTS, __global const int *restrict feature_constants
#define RULE BASIC, feature_constants
#else
#define RULE_CONSTANTS BASIC_CONSTANTS
#define RULE BASIC
#endif

// Index of each pixel's set of transforms: as a parameter of functions, as a parameter of kernels, and as arguments. These macros are empty
// if the table has a single set.
#ifdef SETS
#define SET_VALUE uints set,
#define SET_PARAMETER , __global const uchar *restrict pixel_sets  // (row, col)
#define SET_READ , pixel_sets
#define SET_AT(at) set_values(pixel_sets + (at)),
#if LANES == 1
INLINE uints set_values(__global const uchar *at) { return *at; }
#else
INLINE uints set_values(__global const uchar *at) { return CONVERT(LOAD_GLOBAL(bytes, at), uints); }
#endif
#else
#define SET_VALUE
#define SET_PARAMETER
#define SET_READ
#define SET_AT(at)
#endif

typedef struct {
    uints level_sum, variance_sum;  // sums over channels
    Colour colour;
#ifdef EACH_WINDOW
    ints window_sum[WINDOW_SUMS];   // for optional features of the class recipe
#endif
} Evidence;

INLINE void no_evidence(Evidence *e, RULE_CONSTANTS) {
    e->level_sum = e->variance_sum = (uints)0;
    no_colour(&e->colour, chroma_weights);
#ifdef EACH_WINDOW
    for (int s = 0; s < WINDOW_SUMS; s++) e->window_sum[s] = (ints)0;
#endif
}

// Adds channel c, from the number, sum and sum of squares of its pixels in the patch.
INLINE void add_evidence(Evidence *e, int c, uints count, uints sum, uints square, uints mean_reciprocal,
                         uints variance_reciprocal, RULE_CONSTANTS) {
    const uints scaled = sum * mean_reciprocal;
    e->level_sum += level_part(scaled);
    e->variance_sum += variance_part(count, sum, square, scaled >> 16, variance_reciprocal);
    add_colour(&e->colour, c, scaled, chroma_weights);
}

// Returns the kind: the chroma, or the saturation case if a nearby pixel is saturated. Saturation cases are numbered after the chromas.
INLINE uints kind_of(const Evidence *e, uints site, patterns code, RULE_CONSTANTS) {
    const uints chroma = chroma_of(&e->colour, site, chroma_weights);
    if (!any_case(code, case_of_code)) return chroma;
    const uints saturation = case_of(code, case_of_code);
    return saturation > 0 ? CHROMAS - 1 + saturation : chroma;
}

// Returns the class of pixels at CFA site `site`. `code` is the set of channels that saturate near the pixel. The level is found by comparison
// with every level edge, because table lookups are slow in vectors. The same loop selects the contrast thresholds of the level.
//
// If there are several SETS of transforms (l3cli/rendering/conditions.py), pixels are compared with the thresholds of their `set`. The arrays of
// all sets are concatenated, and sites are numbered consecutively over all sets.
INLINE uints class_of(const Evidence *e, uints site, patterns code, SET_VALUE RULE_CONSTANTS) {
    const uints kind = kind_of(e, site, code, RULE);
    uints level = 0, edge[CONTRASTS];
    first_contrast_edges(edge, contrast_edges);
#ifdef SETS
    uints set_edge[SETS - 1][CONTRASTS];
    for (int s = 1; s < SETS; s++) first_contrast_edges(set_edge[s - 1], contrast_edges + s * (CONTRASTS - 1) * LEVELS);
#endif
    #pragma unroll 4
    for (int l = 1; l < LEVELS; l++) {
        const ints reached = above_level(e->level_sum, level_tops[l - 1]);
        level = reached ? level + 1 : level;
        next_contrast_edges(edge, reached, l, contrast_edges);
#ifdef SETS
        for (int s = 1; s < SETS; s++)
            next_contrast_edges(set_edge[s - 1], reached, l, contrast_edges + s * (CONTRASTS - 1) * LEVELS);
#endif
    }
#ifdef SETS
    for (int s = 1; s < SETS; s++)
        for (int k = 0; k < CONTRASTS - 1; k++) edge[k] = set == (uint)s ? set_edge[s - 1][k] : edge[k];
    site += set * SET_SITES;
#endif
    uints within = level * CONTRASTS + contrast_of(e->variance_sum, edge);
#ifdef EACH_WINDOW
    uints combination = combination_of(e->window_sum, level, feature_constants);
#ifdef SETS
    for (int s = 1; s < SETS; s++) {
        const uints set_combination = combination_of(e->window_sum, level, feature_constants + s * FEATURE_CONSTANTS);
        combination = set == (uint)s ? set_combination : combination;
    }
#endif
    within = within * COMBINATIONS + combination;
#endif
    return (site * (LEVELS * CONTRASTS * COMBINATIONS) + within) * KINDS + kind;
}
