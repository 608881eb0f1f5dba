// Processor variant: what a layer reads and its classes → its outputs: the transform of each pixel's class applied to its patch.
//
// One work-item renders a tile of TILE columns and BAND rows, row after row. A layer reads SOURCES planes: the mosaic, or the
// planes that the layer before has made.
//
// The column-major ring. A patch should be as few vectors as can be, not one short vector a row. So the tile keeps, for each
// padded column, the PATCH latest rows one below the other: column p's padded row k of source s lies at
// ring[p * COLUMN + k * SOURCES + s]. A patch is then PATCH * COLUMN consecutive values. One row on, every window moves by
// SOURCES values, and the new row's pixel of column p falls on the slot after its column, which is where column p + 1 kept the
// row that no patch needs any more. Nothing is moved: one store a value, and the base moves on.
//
// Vectors and a last tap. An odd square is 8n + 1, so a patch of one plane is VECTORS whole vectors (of 16 lanes the last one
// may be half weights of zero) and one tap more, which goes with the intercept: for all outputs of a group together, one vector
// of four.
//
// Fixed point. A vector holds twice as many taps of 16 bits, zeros at the end, and none is left over.
//
// Pairs. Pixels PAIR columns apart have the same site where the CFA's width allows, and so, on plain areas, the same class:
// then the weights, most of what is read, are read once for both.

#define COLUMN (PATCH * SOURCES)
#define TAPS (PATCH * COLUMN)
#ifdef FIXED_POINT
#define VECTORS ((TAPS + TAP_LANES - 1) / TAP_LANES)
#else
#define VECTORS ((TAPS - 1 + TAP_LANES - 1) / TAP_LANES)
#endif
#define GROUPS ((OUTPUTS + 3) / 4)               // outputs are taken in groups …
#define GROUP ((OUTPUTS + GROUPS - 1) / GROUPS)  // … of at most four, so that their sums stay in registers
#define LAST_TAP (VECTORS * GROUP * TAP_LANES)   // where a group's last taps lie, behind them its intercepts
#define GROUP_STRIDE WHOLE(LAST_TAP + 32 / sizeof(tap), 64 / sizeof(tap))
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
// The fours of each vector added up, one four after the other.
INLINE totals fold_all(const totals v[LANES / 4]) {
#if LANES == 16
#define JOIN(u, v, low, high) __builtin_shufflevector(u, v, low, low + 1, low + 2, low + 3, high, high + 1, high + 2, high + 3, \
    low + 16, low + 17, low + 18, low + 19, high + 16, high + 17, high + 18, high + 19)
    const totals ab = JOIN(v[0], v[1], 0, 4) + JOIN(v[0], v[1], 8, 12);
    const totals cd = JOIN(v[2], v[3], 0, 4) + JOIN(v[2], v[3], 8, 12);
    return JOIN(ab, cd, 0, 8) + JOIN(ab, cd, 4, 12);
#else
    return __builtin_shufflevector(v[0], v[1], 0, 1, 2, 3, 8, 9, 10, 11)
         + __builtin_shufflevector(v[0], v[1], 4, 5, 6, 7, 12, 13, 14, 15);
#endif
}

// Where the sums of a pixel begin: output o's last tap and intercept, in lane o.
INLINE four_totals last_taps(const tap *patch, __global const tap *weights) {
#ifdef FIXED_POINT
    return LOAD_GLOBAL(four_totals, (__global const total *)(weights + LAST_TAP));
#else
    return LOAD_GLOBAL(four_totals, weights + LAST_TAP) * patch[TAPS - 1] + LOAD_GLOBAL(four_totals, weights + LAST_TAP + 4);
#endif
}

// A pair's products with the weights of their classes, summed as far as a pair goes.
INLINE void apply_pair(totals sum[GROUP], const tap *first, const tap *second, __global const tap *first_weights,
                       __global const tap *second_weights) {
    const four_totals first_last = last_taps(first, first_weights), second_last = last_taps(second, second_weights);
    totals one[GROUP], other[GROUP];
    #pragma unroll
    for (int o = 0; o < GROUP; o++) {
        one[o] = other[o] = (totals)0;
        one[o][o] = first_last[o];
        other[o][o] = second_last[o];
    }
    #pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        const taps u = LOAD_PRIVATE(taps, first + j * TAP_LANES), v = LOAD_PRIVATE(taps, second + j * TAP_LANES);
        #pragma unroll
        for (int o = 0; o < GROUP; o++) {
            one[o] = add_products(one[o], u, LOAD_GLOBAL(taps, first_weights + (j * GROUP + o) * TAP_LANES));
            other[o] = add_products(other[o], v, LOAD_GLOBAL(taps, second_weights + (j * GROUP + o) * TAP_LANES));
        }
    }
    #pragma unroll
    for (int o = 0; o < GROUP; o++) sum[o] = fold_two(one[o], other[o]);
}

// LANES pixels from x on: plane o of group g → planes[(g * GROUP + o) * TILE + x].
INLINE void apply(total *planes, const tap *patches, const uint *label, __global const tap *weights, int x) {
    for (int g = 0; g < GROUPS; g++) {
        __global const tap *group = weights + g * GROUP_STRIDE;
        totals folded[GROUP][LANES / 4];
        #pragma unroll
        for (int n = 0; n < LANES / 2; n += 2) {
            totals pair[2][GROUP];
            #pragma unroll
            for (int i = 0; i < 2; i++) {
                const int first = PAIR_FIRST(n + i), second = first + PAIR;
                const uint class = label[x + first], other = label[x + second];
                const tap *patch = patches + (x + first) * COLUMN;
                __global const tap *row = group + (size_t)class * CLASS_STRIDE;
                if (class == other)
                    apply_pair(pair[i], patch, patch + PAIR * COLUMN, row, row);
                else
                    apply_pair(pair[i], patch, patch + PAIR * COLUMN, row, group + (size_t)other * CLASS_STRIDE);
            }
            #pragma unroll
            for (int o = 0; o < GROUP; o++) folded[o][n / 2] = fold_four(pair[0][o], pair[1][o]);
        }
        #pragma unroll
        for (int o = 0; o < GROUP; o++) {
            const totals in_pairs = fold_all(folded[o]);
            STORE_PRIVATE(totals, planes + (g * GROUP + o) * TILE + x) =
                __builtin_shufflevector(in_pairs, in_pairs, ALL_LANES(PAIR_PLACE));
        }
    }
}

#define RING (SPAN * COLUMN + (BAND + 2 * RADIUS) * SOURCES + VECTORS * TAP_LANES)

#if SOURCES == 1
#define SOURCE ushort

// The newest row into the ring: to is where column 0's pixel falls. The black level is taken off here: zero signal then
// stays zero in every transform. Integers keep it: their intercepts know it.
INLINE void into_ring(tap *to, __global const ushort *raw, __global const int *column_source, float black_level, int x0, int columns,
                      size_t stride, ushort *row, int span) {
    ingest(row, raw, column_source, x0, columns);
    tap signal[SPAN];
    for (int p = 0; p < span; p += LANES)
#ifdef FIXED_POINT
        STORE_PRIVATE(shorts, signal + p) = LOAD_PRIVATE(shorts, row + p) - (ushort)RAW_MIDDLE;
#else
        STORE_PRIVATE(floats, signal + p) = CONVERT(CONVERT(LOAD_PRIVATE(shorts, row + p), ints), floats) - black_level;
#endif
    #pragma clang loop vectorize(disable) unroll_count(8)
    for (int p = 0; p < span; p++) to[p * COLUMN] = signal[p];
}
#else
#define SOURCE int

// What a layer reads of LANES pixels of a plane.
#ifdef FIXED_POINT
INLINE signed_shorts signal_of(ints plane) { return CONVERT(coarse(plane), signed_shorts); }
#else
INLINE floats signal_of(ints plane) { return CONVERT(plane, floats); }
#endif
VECTOR(tap, signals, LANES);

// The newest row of every plane into the ring.
INLINE void into_ring(tap *to, __global const int *planes, __global const int *column_source, float black_level, int x0,
                      int columns, size_t stride, ushort *row, int span) {
    const int first = max(0, RADIUS - x0), last = min(TILE + 2 * RADIUS, columns - x0 + RADIUS);
    const int end = min(TILE + 2 * RADIUS, columns - x0 + 2 * RADIUS);
    tap signal[SOURCES][SPAN];
    for (int s = 0; s < SOURCES; s++, planes += stride) {
        int p = first;
        for (; p + LANES <= last; p += LANES)
            STORE_PRIVATE(signals, signal[s] + p) = signal_of(LOAD_GLOBAL(ints, planes + x0 - RADIUS + p));
        for (int i = 0; i < first; i++) signal[s][i] = signal_of((ints)planes[column_source[x0 + i]])[0];
        for (; p < end; p++) signal[s][p] = signal_of((ints)planes[column_source[x0 + p]])[0];
    }
    #pragma clang loop vectorize(disable) unroll_count(4)
    for (int p = 0; p < end; p++)
        for (int s = 0; s < SOURCES; s++) to[p * COLUMN + s] = signal[s][p];
}
#endif

#ifdef FIXED_POINT
// Sums of LANES pixels from x on → planes in their place.
INLINE void to_planes(total *sums, const uint *label, __global const tap *weights, int x) {
    int fraction[LANES];
    #pragma clang loop vectorize(disable)
    for (int i = 0; i < LANES; i++)
        fraction[i] = ((__global const total *)(weights + (size_t)label[x + i] * CLASS_STRIDE + LAST_TAP))[3];
    for (int o = 0; o < GROUP; o++) {
        total *plane = sums + o * TILE + x;
        STORE_PRIVATE(ints, plane) = plane_value(LOAD_PRIVATE(ints, plane), LOAD_PRIVATE(ints, fraction));
    }
}
#endif

__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void transform(__global const SOURCE *restrict source,      // (source, row, col) DN of the mosaic, or planes
               __global const int *restrict row_source,     // (padded row)
               __global const int *restrict column_source,  // (padded col)
               __global const uint *restrict labels,        // (row, col)
               __global const tap *restrict weights,        // (class, group, CLASS_STRIDE) per unit of the source, see above
               __global const float *restrict matrix,       // (3, 3) encoded values from X, Y, Z, before the curve
               __global CODE *restrict picture,
               float black_level, int source_rows, int rows, int columns) {
    const int x0 = get_group_id(0) * TILE, y0 = get_group_id(1) * BAND;
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int span = WHOLE(WHOLE(width, LANES) + 2 * RADIUS, 16);
    const size_t stride = (size_t)source_rows * columns;
    ushort row[SPAN];
    uint label[TILE];
    tap ring[RING];
    total planes[GROUPS * GROUP * TILE];
    for (int i = 0; i < SPAN; i++) row[i] = 0;
    for (int i = 0; i < TILE; i++) label[i] = 0;
    for (int i = 0; i < RING; i++) ring[i] = 0;
    for (int k = 0; k < y1 - y0 + 2 * RADIUS; k++) {
        into_ring(ring + k * SOURCES, source + (size_t)row_source[y0 + k] * columns, column_source, black_level, x0, columns,
                  stride, row, span);
        if (k < 2 * RADIUS) continue;
        const int y = y0 + k - 2 * RADIUS;
        const size_t at = (size_t)y * columns + x0;
        for (int x = 0; x < width; x++) label[x] = labels[at + x];
        for (int x = 0; x < width; x += LANES) {
            apply(planes, ring + (k - 2 * RADIUS) * SOURCES, label, weights, x);
#ifdef FIXED_POINT
            to_planes(planes, label, weights, x);
#endif
        }
        write_row(picture, planes, matrix, at, width, (size_t)rows * columns);
    }
}
