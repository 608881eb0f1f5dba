// Processor variant: pairs of pixels, and sums over the lanes of vectors.
//
// Pairs. Pixels PAIR columns apart have the same site where the CFA's width allows, and so, on plain areas, the same class:
// then the weights, most of what is read, are read once for both.

// How many fours of pixels are laid out one after the other in code. A loop is compiled in half the time. It is as fast before a further
// layer; elsewhere it takes up to 4 % longer, which counts less where outputs are wanted as they are: mostly of one frame, for its exposure.
#if defined(FIXED_POINT) || defined(PLANES)
#define UNROLLED 1
#else
#define UNROLLED (LANES / 4)
#endif

#define COLUMN (PATCH * SOURCES)  // values of a column of the ring (transform.cl)
#define TAPS (PATCH * COLUMN)

// Which of two arrangements of weights there is (layout.py): side_by_side.cl, or else floating_point.cl.
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

// Sums over lanes, of several vectors at once: each step halves the vectors. [a b] and so on stand for lanes of each four.
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
// Fours of u and v by their first lanes.
#define JOIN(u, v, low, high) __builtin_shufflevector(u, v, low, low + 1, low + 2, low + 3, high, high + 1, high + 2, high + 3, \
    low + 16, low + 17, low + 18, low + 19, high + 16, high + 17, high + 18, high + 19)
#endif
