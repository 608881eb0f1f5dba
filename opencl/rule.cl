// From the sums of a patch to its class, for as many pixels as `uints` holds: the formulas of l3cli/classes in uint,
// exact or wrapping to exact, for both variants.

// CFA phase of padded row or column p, whose frame begins at phase `start`: that of p - RADIUS.
#define PADDED_PHASE(p, start, period) (((p) + (start) + ((period) - 1) * RADIUS) % (period))

typedef struct {
    uints level_sum, variance_sum;  // over the channels seen so far
    ints score[CHROMAS];            // of each chroma; the lowest wins
} Evidence;

INLINE void no_evidence(Evidence *e) {
    e->level_sum = e->variance_sum = (uints)0;
    #pragma unroll
    for (int k = 0; k < CHROMAS; k++) e->score[k] = (ints)0;
}

// What channel c says: `count`, `sum` and `square` of its pixels in the patch, and the reciprocals that go with the count.
INLINE void add_evidence(Evidence *e, int c, uints count, uints sum, uints square, uints mean_reciprocal,
                         uints variance_reciprocal, __global const int *chroma_weights) {
    const uints scaled = sum * mean_reciprocal, mean = scaled >> 16, cap = 0xffffffffu / CHANNELS;
    const uints deviation = square - mean * (sum + sum - mean * count), variance = deviation * variance_reciprocal;
    e->level_sum += scaled >> (16 - LEVEL_FRACTION);
    e->variance_sum += variance > cap ? cap : variance;
#if CHROMAS > 1
    const ints above_black = SAME_BITS(scaled >> (16 - CHROMA_FRACTION), ints) - CHROMA_BLACK;
    const ints signal = above_black > 0 ? above_black : (ints)0;
    #pragma unroll
    for (int k = 0; k < CHROMAS; k++) e->score[k] += signal * chroma_weights[k * CHANNELS + c];
#endif
}

// Level and contrast as level * CONTRASTS + contrast. Comparing with every edge needs no look-up, which vectors are slow at.
// Level sums are below 2^31: signed comparison is one instruction on every processor, unsigned is not.
INLINE uints level_and_contrast(const Evidence *e, __global const int *level_tops, __global const uint *contrast_edges) {
    const ints level_sum = SAME_BITS(e->level_sum, ints);
    uints level = 0, contrast = 0, edge[CONTRASTS];
    for (int k = 0; k < CONTRASTS - 1; k++) edge[k] = contrast_edges[k * LEVELS];
    #pragma unroll 4
    for (int l = 1; l < LEVELS; l++) {
        const ints below = level_tops[l - 1];
        level = level_sum > below ? level + 1 : level;
        for (int k = 0; k < CONTRASTS - 1; k++)
            edge[k] = level_sum > below ? (uints)contrast_edges[k * LEVELS + l] : edge[k];
    }
    for (int k = 0; k < CONTRASTS - 1; k++) contrast = e->variance_sum > edge[k] ? contrast + 1 : contrast;
    return level * CONTRASTS + contrast;
}

// The chroma of the lowest score, the first of equals.
INLINE uints chroma_of(const Evidence *e) {
    ints least = e->score[0];
    uints chroma = 0;
    #pragma unroll
    for (int k = 1; k < CHROMAS; k++) {
        chroma = e->score[k] < least ? (uints)k : chroma;
        least = e->score[k] < least ? e->score[k] : least;
    }
    return chroma;
}
