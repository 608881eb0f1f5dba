// Chroma: the formula of l3cli/classes/chroma.py.

#define CHROMA_PAIRS ((CHANNELS + 1) / 2)
// Of each chroma 32768 times the sum of its weights, then the weights, two channels in a word.
#define CHROMA_CONSTANTS __global const int *restrict chroma_weights  // (chroma, 1 + CHROMA_PAIRS)
#define START_OF(k) chroma_weights[(k) * (1 + CHROMA_PAIRS)]

// What the scores know of the channels seen so far.
typedef struct {
#if LANES == 1
    ints score[CHROMAS];       // of each chroma; the lowest wins
#else
    uints pair[CHROMA_PAIRS];  // signals less 32768 in 16 bits, two channels in a word
#endif
} Colour;

INLINE void no_colour(Colour *colour, __global const int *chroma_weights) {
#if LANES == 1
    for (int k = 0; k < CHROMAS; k++) colour->score[k] = START_OF(k);
#else
    #pragma unroll
    for (int i = 0; i < CHROMA_PAIRS; i++) colour->pair[i] = (uints)0;
#endif
}

// Add what channel c says; `scaled` is its mean times 65536.
INLINE void add_colour(Colour *colour, int c, uints scaled, __global const int *chroma_weights) {
#if CHROMAS > 1
    const ints above_black = SAME_BITS(scaled >> (16 - CHROMA_FRACTION), ints) - CHROMA_BLACK_LEVEL, top = CHROMA_TOP;
    const ints positive = above_black > 0 ? above_black : (ints)0, signal = (positive < top ? positive : top) ^ 0x8000;
#if LANES == 1
    for (int k = 0; k < CHROMAS; k++) {
        const int weights = chroma_weights[k * (1 + CHROMA_PAIRS) + 1 + c / 2];
        colour->score[k] += (short)signal * (short)(c % 2 ? weights >> 16 : weights);
    }
#else
    colour->pair[c / 2] |= SAME_BITS(c % 2 ? signal << 16 : signal, uints);
#endif
#endif
}

INLINE ints score_of(const Colour *colour, int k, __global const int *chroma_weights) {
#if LANES == 1
    return colour->score[k];
#else
    ints score = START_OF(k);
    #pragma unroll
    for (int i = 0; i < CHROMA_PAIRS; i++) {
        const ints weights = chroma_weights[k * (1 + CHROMA_PAIRS) + 1 + i];
        score = add_pairs(score, SAME_BITS(colour->pair[i], pairs), SAME_BITS(weights, pairs));
    }
    return score;
#endif
}

// The chroma of the lowest score, the first of equals.
INLINE uints chroma_of(const Colour *colour, __global const int *chroma_weights) {
    uints chroma = 0;
#if CHROMAS > 1
    ints least = score_of(colour, 0, chroma_weights);
    #pragma unroll
    for (int k = 1; k < CHROMAS; k++) {
        const ints score = score_of(colour, k, chroma_weights);
        chroma = score < least ? (uints)k : chroma;
        least = score < least ? score : least;
    }
#endif
    return chroma;
}
