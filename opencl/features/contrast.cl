// Class feature contrast (l3cli/classes/contrast.py).

#define CONTRAST_CONSTANTS __global const uint *restrict contrast_edges  // (contrast edge, level)

// A channel's term in the variance sum, from the number, sum and sum of squares of its pixels in the patch.
INLINE uints variance_part(uints count, uints sum, uints square, uints mean, uints variance_reciprocal) {
    const uints cap = 0xffffffffu / CHANNELS;
    const uints deviation = square - mean * (sum + sum - mean * count), variance = deviation * variance_reciprocal;
    return variance > cap ? cap : variance;
}

// Reads the contrast thresholds of the darkest level.
INLINE void first_contrast_edges(uints *edge, __global const uint *contrast_edges) {
    for (int k = 0; k < CONTRASTS - 1; k++) edge[k] = contrast_edges[k * LEVELS];
}

// Replaces the thresholds with those of `level` if the pixel reaches this level.
INLINE void next_contrast_edges(uints *edge, ints reached, int level, __global const uint *contrast_edges) {
    for (int k = 0; k < CONTRASTS - 1; k++) edge[k] = reached ? (uints)contrast_edges[k * LEVELS + level] : edge[k];
}

INLINE uints contrast_of(uints variance_sum, const uints *edge) {
    uints contrast = 0;
    for (int k = 0; k < CONTRASTS - 1; k++) contrast = variance_sum > edge[k] ? contrast + 1 : contrast;
    return contrast;
}
