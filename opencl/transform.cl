// Processor variant: raw frame and classes → outputs: the transform of each pixel's class applied to its patch, and encoded.
//
// One work-item renders a tile of TILE columns and BAND rows, row after row.
//
// The column-major ring. A patch should be as few vectors as can be, not one short vector a row. So the tile keeps, for each
// padded column, the PATCH latest rows one below the other: column p's padded row k lies at ring[p * PATCH + k]. A patch is
// then PATCH * PATCH consecutive floats. One row on, every window moves by one float, and the new row's pixel of column p
// falls on the slot after its column, which is where column p + 1 kept the row that no patch needs any more. Nothing is
// moved: one store a pixel, and the base moves on.
//
// Vectors and a last tap. An odd square is 8n + 1, so a patch is VECTORS whole vectors (of 16 lanes the last one may be half
// weights of zero) and one tap more, which goes with the intercept: for all outputs of a group together, one vector of four.
//
// Pairs. Pixels PAIR columns apart have the same site where the CFA's width allows, and so, on plain areas, the same class:
// then the weights, most of what is read, are read once for both.

#define VECTORS ((PATCH * PATCH - 1 + LANES - 1) / LANES)
#define GROUPS ((OUTPUTS + 3) / 4)               // outputs are taken in groups …
#define GROUP ((OUTPUTS + GROUPS - 1) / GROUPS)  // … of at most four, so that their sums stay in registers
#define LAST_TAP (VECTORS * GROUP * LANES)       // where a group's last taps lie, behind them its intercepts
#define GROUP_STRIDE WHOLE(LAST_TAP + 8, 16)
#define CLASS_STRIDE (GROUPS * GROUP_STRIDE)

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
#define ALL_LANES(index) index(0), index(1), index(2), index(3), index(4), index(5), index(6), index(7), \
    index(8), index(9), index(10), index(11), index(12), index(13), index(14), index(15)
#else
#define SHUFFLE_FOURS(u, v, i, j, k, l) __builtin_shufflevector(u, v, i, j, k, l, i + 4, j + 4, k + 4, l + 4)
#define ALL_LANES(index) index(0), index(1), index(2), index(3), index(4), index(5), index(6), index(7)
#endif

// Lanes 0 2 and 1 3 of each four → [a b a b]
INLINE floats fold_two(floats a, floats b) {
    return SHUFFLE_FOURS(a, b, 0, LANES, 1, LANES + 1) + SHUFFLE_FOURS(a, b, 2, LANES + 2, 3, LANES + 3);
}
// [a b a b], [c d c d] → [a b c d]
INLINE floats fold_four(floats ab, floats cd) {
    return SHUFFLE_FOURS(ab, cd, 0, 1, LANES, LANES + 1) + SHUFFLE_FOURS(ab, cd, 2, 3, LANES + 2, LANES + 3);
}
// The fours of each vector added up, one four after the other.
INLINE floats fold_all(const floats v[LANES / 4]) {
#if LANES == 16
#define JOIN(u, v, low, high) __builtin_shufflevector(u, v, low, low + 1, low + 2, low + 3, high, high + 1, high + 2, high + 3, \
    low + 16, low + 17, low + 18, low + 19, high + 16, high + 17, high + 18, high + 19)
    const floats ab = JOIN(v[0], v[1], 0, 4) + JOIN(v[0], v[1], 8, 12);
    const floats cd = JOIN(v[2], v[3], 0, 4) + JOIN(v[2], v[3], 8, 12);
    return JOIN(ab, cd, 0, 8) + JOIN(ab, cd, 4, 12);
#else
    return __builtin_shufflevector(v[0], v[1], 0, 1, 2, 3, 8, 9, 10, 11)
         + __builtin_shufflevector(v[0], v[1], 4, 5, 6, 7, 12, 13, 14, 15);
#endif
}

// Where the sums of a pixel begin: output o's last tap and intercept, in lane o.
INLINE float4 last_taps(const float *patch, __global const float *weights) {
    return FIXED(four_floats, weights + LAST_TAP) * patch[PATCH * PATCH - 1] + FIXED(four_floats, weights + LAST_TAP + 4);
}

// A pair's products with the weights of their classes, summed as far as a pair goes.
INLINE void apply_pair(floats sum[GROUP], const float *first, const float *second, __global const float *first_weights,
                       __global const float *second_weights) {
    const float4 first_last = last_taps(first, first_weights), second_last = last_taps(second, second_weights);
    floats one[GROUP], other[GROUP];
    #pragma unroll
    for (int o = 0; o < GROUP; o++) {
        one[o] = other[o] = (floats)0.0f;
        one[o][o] = first_last[o];
        other[o][o] = second_last[o];
    }
    #pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        const floats u = NEAR(floats, first + j * LANES), v = NEAR(floats, second + j * LANES);
        #pragma unroll
        for (int o = 0; o < GROUP; o++) {
            one[o] += u * FIXED(floats, first_weights + (j * GROUP + o) * LANES);
            other[o] += v * FIXED(floats, second_weights + (j * GROUP + o) * LANES);
        }
    }
    #pragma unroll
    for (int o = 0; o < GROUP; o++) sum[o] = fold_two(one[o], other[o]);
}

// LANES pixels from x on: plane o of group g → planes[(g * GROUP + o) * TILE + x].
INLINE void apply(float *planes, const float *patches, const uint *label, __global const float *weights, int x) {
    for (int g = 0; g < GROUPS; g++) {
        __global const float *group = weights + g * GROUP_STRIDE;
        floats folded[GROUP][LANES / 4];
        #pragma unroll
        for (int n = 0; n < LANES / 2; n += 2) {
            floats pair[2][GROUP];
            #pragma unroll
            for (int i = 0; i < 2; i++) {
                const int first = PAIR_FIRST(n + i), second = first + PAIR;
                const uint class = label[x + first], other = label[x + second];
                const float *patch = patches + (x + first) * PATCH;
                __global const float *row = group + (size_t)class * CLASS_STRIDE;
                if (class == other)
                    apply_pair(pair[i], patch, patch + PAIR * PATCH, row, row);
                else
                    apply_pair(pair[i], patch, patch + PAIR * PATCH, row, group + (size_t)other * CLASS_STRIDE);
            }
            #pragma unroll
            for (int o = 0; o < GROUP; o++) folded[o][n / 2] = fold_four(pair[0][o], pair[1][o]);
        }
        #pragma unroll
        for (int o = 0; o < GROUP; o++) {
            const floats in_pairs = fold_all(folded[o]);
            NEAR(floats, planes + (g * GROUP + o) * TILE + x) =
                __builtin_shufflevector(in_pairs, in_pairs, ALL_LANES(PAIR_PLACE));
        }
    }
}

// The newest row into the ring: to is where column 0's pixel falls. The black level is taken off here: zero signal then
// stays zero in every transform.
INLINE void into_ring(float *to, const ushort *row, float black, int span) {
    float signal[SPAN];
    for (int p = 0; p < span; p += LANES)
        NEAR(floats, signal + p) = CONVERT(CONVERT(NEAR(shorts, row + p), ints), floats) - black;
    #pragma clang loop vectorize(disable) unroll_count(8)
    for (int p = 0; p < span; p++) to[p * PATCH] = signal[p];
}

#define RING (SPAN * PATCH + BAND + 2 * RADIUS + VECTORS * LANES)

__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void transform(__global const ushort *restrict raw,         // (row, col) DN
               __global const int *restrict row_source,     // (padded row)
               __global const int *restrict column_source,  // (padded col)
               __global const uint *restrict labels,        // (row, col)
               __global const float *restrict weights,      // (class, group, CLASS_STRIDE) per DN, see above
               __global const float *restrict matrix,       // (3, 3) encoded values from X, Y, Z, before the curve
               __global CODE *restrict picture,
               float black, int rows, int columns) {
    const int x0 = get_group_id(0) * TILE, y0 = get_group_id(1) * BAND;
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int span = WHOLE(WHOLE(width, LANES) + 2 * RADIUS, 16);
    ushort row[SPAN];
    uint label[TILE];
    float ring[RING], planes[GROUPS * GROUP * TILE];
    for (int i = 0; i < SPAN; i++) row[i] = 0;
    for (int i = 0; i < TILE; i++) label[i] = 0;
    for (int i = 0; i < RING; i++) ring[i] = 0.0f;
    for (int k = 0; k < y1 - y0 + 2 * RADIUS; k++) {
        ingest(row, raw + (size_t)row_source[y0 + k] * columns, column_source, x0, columns);
        into_ring(ring + k, row, black, span);
        if (k < 2 * RADIUS) continue;
        const int y = y0 + k - 2 * RADIUS;
        const size_t at = (size_t)y * columns + x0;
        for (int x = 0; x < width; x++) label[x] = labels[at + x];
        for (int x = 0; x < width; x += LANES) apply(planes, ring + k - 2 * RADIUS, label, weights, x);
        write_row(picture, planes, matrix, at, width, (size_t)rows * columns);
    }
}
