// Processor variant: pairs of pixels, and sums over the lanes of vectors.
//
// Pairs: pixels that are PAIR columns apart have the same site, if the CFA's width allows, and so the same class in uniform areas. Then
// the weights, which are most of the data, are read once for both.

// How many groups of four pixels are unrolled. A loop compiles in half the time, and runs as fast if another layer follows. Otherwise it
// is up to 4 % slower, which matters less for outputs, since these are mostly wanted of a single frame, for its exposure.
#if defined(FIXED_POINT) || defined(PLANES)
#define UNROLLED 1
#else
#define UNROLLED (LANES / 4)
#endif

#define COLUMN (PATCH * SOURCES)  // values per column of the ring (transform.cl)
#define TAPS (PATCH * COLUMN)

// The arrangement of weights (layout.py): either side_by_side.cl or floating_point.cl.
#if defined(FIXED_POINT) || (OUTPUTS >= 3 && OUTPUTS <= 4 && TAPS <= 25 && !defined(RATIO_TAPS))
#define SIDE_BY_SIDE
#endif

#if 2 * CFA_COLUMNS <= LANES && (CFA_COLUMNS & (CFA_COLUMNS - 1)) == 0
#define PAIR CFA_COLUMNS
#else
#define PAIR (LANES / 2)
#endif
#define PAIR_FIRST(n) ((n) / PAIR * 2 * PAIR + (n) % PAIR)                     // first pixel of the n-th pair of LANES
#define PAIR_PLACE(x) (2 * ((x) / (2 * PAIR) * PAIR + (x) % PAIR) + (x) / PAIR % 2)  // pixel x among all pairs' pixels

// Sums over lanes, for several vectors at once. Each step halves the number of vectors. [a b …] stand for the lanes of each four.
#if LANES == 16
#define SHUFFLE_FOURS(u, v, i, j, k, l) __builtin_shufflevector(u, v, i, j, k, l, i + 4, j + 4, k + 4, l + 4, \
    i + 8, j + 8, k + 8, l + 8, i + 12, j + 12, k + 12, l + 12)
#else
#define SHUFFLE_FOURS(u, v, i, j, k, l) __builtin_shufflevector(u, v, i, j, k, l, i + 4, j + 4, k + 4, l + 4)
#endif

// Lanes 0 2 and 1 3 of each four → [a b a b]
INLINE totals fold_two(totals a, totals b) {
    return SHUFFLE_FOURS(a, b, 0, LANES, 1, LANES + 1) + SHUFFLE_FOURS(a, b, 2, LANES + 2, 3, LANES + 3);
}
// [a b a b], [c d c d] → [a b c d]
INLINE totals fold_four(totals ab, totals cd) {
    return SHUFFLE_FOURS(ab, cd, 0, 1, LANES, LANES + 1) + SHUFFLE_FOURS(ab, cd, 2, 3, LANES + 2, LANES + 3);
}
#if LANES == 16
// Combines groups of four lanes of u and v, by their first lanes.
#define JOIN(u, v, low, high) __builtin_shufflevector(u, v, low, low + 1, low + 2, low + 3, high, high + 1, high + 2, high + 3, \
    low + 16, low + 17, low + 18, low + 19, high + 16, high + 17, high + 18, high + 19)
#endif
