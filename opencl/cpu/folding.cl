// Processor variant: processes pixels in pairs, and adds up the lanes of vectors.
//
// The two pixels of a pair are PAIR columns apart. If the CFA width permits, they have the same CFA site, and therefore the same class in uniform
// areas. The weights, which are most of the data, are then read once for both.

// Number of unrolled loop iterations of four pixels each. In the last layer, a loop that is not unrolled is up to 4 % slower.
#ifdef FIXED_POINT
#define UNROLLED 1
#else
#define UNROLLED (LANES / 4)
#endif

#define COLUMN (PATCH * SOURCES)  // values per column of the ring (transform.cl)
#define TAPS (PATCH * COLUMN)

// Selects the format of the weights (layout.py), and the file that applies them: side_by_side.cl or floating_point.cl.
#if defined(FIXED_POINT) || (OUTPUTS >= 3 && OUTPUTS <= 4 && TAPS <= 25 && !defined(RATIO_TAPS))
#define SIDE_BY_SIDE
#endif

#if 2 * CFA_COLUMNS <= LANES && (CFA_COLUMNS & (CFA_COLUMNS - 1)) == 0
#define PAIR CFA_COLUMNS
#else
#define PAIR (LANES / 2)
#endif
#define PAIR_FIRST(n) ((n) / PAIR * 2 * PAIR + (n) % PAIR)                     // first pixel of pair n among LANES pixels
#define PAIR_PLACE(x) (2 * ((x) / (2 * PAIR) * PAIR + (x) % PAIR) + (x) / PAIR % 2)  // index of pixel x if sorted by pair

// The following functions add up the lanes of several vectors at the same time. Each step halves the number of vectors. Vectors consist of groups
// of four lanes. A list such as [a b a b] tells from which vector each of the four lanes comes. SHUFFLE_FOURS builds each group of its result from
// lanes i, j, k and l of the same group in u and v, where lanes of v are counted from LANES.
#if LANES == 16
#define SHUFFLE_FOURS(u, v, i, j, k, l) __builtin_shufflevector(u, v, i, j, k, l, i + 4, j + 4, k + 4, l + 4, \
    i + 8, j + 8, k + 8, l + 8, i + 12, j + 12, k + 12, l + 12)
#else
#define SHUFFLE_FOURS(u, v, i, j, k, l) __builtin_shufflevector(u, v, i, j, k, l, i + 4, j + 4, k + 4, l + 4)
#endif

// Adds lanes 0 and 2, and lanes 1 and 3, in each group of a and b. The partial sums alternate in the result: [a b a b].
INLINE totals fold_two(totals a, totals b) {
    return SHUFFLE_FOURS(a, b, 0, LANES, 1, LANES + 1) + SHUFFLE_FOURS(a, b, 2, LANES + 2, 3, LANES + 3);
}
// Completes the sums from two results of fold_two, [a b a b] and [c d c d]. Each group of the result contains the sums [a b c d].
INLINE totals fold_four(totals ab, totals cd) {
    return SHUFFLE_FOURS(ab, cd, 0, 1, LANES, LANES + 1) + SHUFFLE_FOURS(ab, cd, 2, 3, LANES + 2, LANES + 3);
}
#if LANES == 16
// Concatenates two groups of four lanes from u and the same two groups from v. `low` and `high` are the first lanes of these groups.
#define JOIN(u, v, low, high) __builtin_shufflevector(u, v, low, low + 1, low + 2, low + 3, high, high + 1, high + 2, high + 3, \
    low + 16, low + 17, low + 18, low + 19, high + 16, high + 17, high + 18, high + 19)
#endif
