// Numerators and denominators of a decision tree's tests, for both variants (l3cli/classes/tree.py).

// Weighted sums over a pixel's neighbourhood. u and v are the chroma planes.
typedef struct {
    ints xx, yy, xy, chroma_xx, chroma_yy, u_along, v_along;                    // products of gradients over 5 × 5 pixels
    ints chroma_bend_xx, chroma_bend_yy;                                        // squared second differences of chroma over 5 × 5 pixels
    ints narrow_strength, bend_xx, bend_yy, slope_x, slope_y, u, v, luminance;  // over 3 × 3 pixels
    ints bend_x, bend_y;                                                        // second differences at the pixel
} Sums;

typedef struct {
    floats numerator[TESTS], denominator[4];
} Evidence;

INLINE ints size_of(ints value) { return value > 0 ? value : -value; }
INLINE ints larger(ints a, ints b) { return a > b ? a : b; }
INLINE floats signed_square(ints value) { return CONVERT(value * size_of(value), floats); }

// Bits of the gradient word that contain the orientation of the site.
#define TRANSPOSED 14
#define MIRRORED_ACROSS 15
#define MIRRORED_DOWN 16
#define SWAP_WHERE(condition, a, b) { const ints swapped = a; a = (condition) ? b : a; b = (condition) ? swapped : b; }

// Turns or mirrors the sums to the orientation in which the site was trained.
INLINE void turn(Sums *s, uints turns) {
    const ints transposed = (turns >> TRANSPOSED & 1) != 0, across = (turns >> MIRRORED_ACROSS & 1) != 0;
    const ints down = (turns >> MIRRORED_DOWN & 1) != 0;
    SWAP_WHERE(transposed, s->xx, s->yy)
    SWAP_WHERE(transposed, s->chroma_xx, s->chroma_yy)
    SWAP_WHERE(transposed, s->chroma_bend_xx, s->chroma_bend_yy)
    SWAP_WHERE(transposed, s->bend_xx, s->bend_yy)
    SWAP_WHERE(transposed, s->bend_x, s->bend_y)
    SWAP_WHERE(transposed, s->slope_x, s->slope_y)
    s->slope_x = across ? -s->slope_x : s->slope_x;
    s->slope_y = down ? -s->slope_y : s->slope_y;
    s->xy = across != down ? -s->xy : s->xy;
}

// Only quantities that some node of the tree uses are computed.
#define USED(test) (TESTS_USED >> (test) & 1)
#define SLOPES_USED (USED(16) || USED(17))
#define CHROMA_BENDS_USED (USED(21) || USED(22))
#define NUMERATOR(test, value) if (USED(test)) n[test] = value;

INLINE void weigh(Evidence *e, const Sums *s) {
    const ints trace = s->xx + s->yy, straight = s->xx - s->yy, diagonal = 2 * s->xy;
    const ints chroma = s->chroma_xx + s->chroma_yy, both = ((size_of(straight) + size_of(diagonal)) >> 6) * 45;
    floats *n = e->numerator, *d = e->denominator;
    NUMERATOR(0, CONVERT(trace, floats))
    NUMERATOR(1, CONVERT(straight, floats))
    NUMERATOR(2, CONVERT(diagonal, floats))
    NUMERATOR(3, CONVERT(straight + diagonal, floats))
    NUMERATOR(4, CONVERT(straight - diagonal, floats))
    NUMERATOR(5, CONVERT(larger(larger(size_of(straight), size_of(diagonal)), both), floats))
    NUMERATOR(6, CONVERT(s->narrow_strength, floats))
    NUMERATOR(7, CONVERT(chroma, floats))
    NUMERATOR(8, CONVERT(chroma, floats))
    NUMERATOR(9, CONVERT(s->chroma_xx - s->chroma_yy, floats))
    NUMERATOR(10, CONVERT(s->u_along, floats))
    NUMERATOR(11, CONVERT(s->v_along, floats))
    NUMERATOR(12, CONVERT(s->bend_xx, floats))
    NUMERATOR(13, CONVERT(s->bend_yy, floats))
    NUMERATOR(14, signed_square(s->bend_x))
    NUMERATOR(15, signed_square(s->bend_y))
    NUMERATOR(16, signed_square(s->slope_x))
    NUMERATOR(17, signed_square(s->slope_y))
    NUMERATOR(18, CONVERT(s->u, floats))
    NUMERATOR(19, CONVERT(s->v, floats))
    NUMERATOR(20, CONVERT(s->luminance, floats))
    NUMERATOR(21, CONVERT(s->chroma_bend_xx - s->chroma_bend_yy, floats))
    NUMERATOR(22, CONVERT(s->chroma_bend_xx + s->chroma_bend_yy, floats))
    d[0] = (floats)1.0f;
    d[1] = CONVERT(trace + NOISE_TRACE, floats);
    d[2] = CONVERT(chroma + NOISE_TRACE, floats);
    d[3] = CONVERT(larger(s->luminance, (ints)DARKEST_LUMINANCE), floats);
}
