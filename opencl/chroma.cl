// Chroma: the formula of l3cli/classes/chroma.py.

#define CHROMA_CONSTANTS __global const int *restrict chroma_weights  // (chroma, channel)

// Add to the scores (chroma) what channel c says; `scaled` is its mean times 65536.
INLINE void add_scores(ints *score, int c, uints scaled, __global const int *chroma_weights) {
#if CHROMAS > 1
    const ints above_black = SAME_BITS(scaled >> (16 - CHROMA_FRACTION), ints) - CHROMA_BLACK_LEVEL;
    const ints signal = above_black > 0 ? above_black : (ints)0;
    #pragma unroll
    for (int k = 0; k < CHROMAS; k++) score[k] += signal * chroma_weights[k * CHANNELS + c];
#endif
}

// The chroma of the lowest score, the first of equals.
INLINE uints chroma_of(const ints *score) {
    ints least = score[0];
    uints chroma = 0;
    #pragma unroll
    for (int k = 1; k < CHROMAS; k++) {
        chroma = score[k] < least ? (uints)k : chroma;
        least = score[k] < least ? score[k] : least;
    }
    return chroma;
}
