// Class feature chroma (l3cli/classes/chroma.py).

#define CHROMA_PAIRS ((CHANNELS + 1) / 2)
// One row per chroma, and a last row for the sum of all channels. A row contains the start value of the score (32768 times the sum of the
// weights), the dither width, and the weights, two channels per word.
#define CHROMA_CONSTANTS __global const int *restrict chroma_weights  // (chroma + 1, 2 + CHROMA_PAIRS)
#define START_OF(k) chroma_weights[(k) * (2 + CHROMA_PAIRS)]
#define WIDTH_OF(k) chroma_weights[(k) * (2 + CHROMA_PAIRS) + 1]
#define SCORES (CHROMAS + 1)

// The colour of the patch: scores of all chromas (one pixel), or the signals from which scores are computed (vectors).
typedef struct {
#if LANES == 1
    ints score[SCORES];        // score of each chroma (the lowest wins), then the sum of all channels
#else
    uints pair[CHROMA_PAIRS];  // signals minus 32768, two 16-bit channels per word
#endif
} Colour;

INLINE void no_colour(Colour *colour, __global const int *chroma_weights) {
#if LANES == 1
    for (int k = 0; k < SCORES; k++) colour->score[k] = START_OF(k);
#else
    #pragma unroll
    for (int i = 0; i < CHROMA_PAIRS; i++) colour->pair[i] = (uints)0;
#endif
}

// Adds channel c. `scaled` is the channel mean times 65536.
INLINE void add_colour(Colour *colour, int c, uints scaled, __global const int *chroma_weights) {
#if CHROMAS > 1
    const ints above_black = SAME_BITS(scaled >> (16 - CHROMA_FRACTION), ints) - CHROMA_BLACK_LEVEL, top = CHROMA_TOP;
    const ints positive = above_black > 0 ? above_black : (ints)0, signal = (positive < top ? positive : top) ^ 0x8000;
#if LANES == 1
    for (int k = 0; k < SCORES; k++) {
        const int weights = chroma_weights[k * (2 + CHROMA_PAIRS) + 2 + c / 2];
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
        const ints weights = chroma_weights[k * (2 + CHROMA_PAIRS) + 2 + i];
        score = add_pairs(score, SAME_BITS(colour->pair[i], pairs), SAME_BITS(weights, pairs));
    }
    return score;
#endif
}

// Returns the chroma with the lowest score, or the first of several. If the rule dithers and the second-lowest score is close, some sites use
// the chroma with this score instead.
INLINE uints chroma_of(const Colour *colour, uints site, __global const int *chroma_weights) {
    uints chroma = 0;
#if CHROMAS > 1
    ints least = score_of(colour, 0, chroma_weights);
#ifdef CHROMA_TURN
    uints second = 0;
    ints next = 0x7FFFFFFF, width = WIDTH_OF(0);
#endif
    #pragma unroll
    for (int k = 1; k < CHROMAS; k++) {
        const ints score = score_of(colour, k, chroma_weights);
#ifdef CHROMA_TURN
        second = score < least ? chroma : score < next ? (uints)k : second;
        next = score < least ? least : score < next ? score : next;
        width = score < least ? (ints)WIDTH_OF(k) : width;
#endif
        chroma = score < least ? (uints)k : chroma;
        least = score < least ? score : least;
    }
#ifdef CHROMA_TURN
    const ints turn = SAME_BITS(2 * (site * CHROMA_TURN + CHROMA_TURN / 2 & 255), ints) - 255;
    const ints reach = (score_of(colour, CHROMAS, chroma_weights) >> WIDTH_FRACTION) * width >> 8;
    chroma = next - least < reach * (chroma < second ? turn : -turn) ? second : chroma;
#endif
#endif
    return chroma;
}
