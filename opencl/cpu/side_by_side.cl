// Processor variant: computes all outputs of a pixel in the same vector, for fixed-point layers (16-bit values, 32-bit sums), and for
// floating-point layers with small patches.
//
// A vector of weights contains ONCE taps for each output, and the sums of an output occupy four lanes. ONCE taps of the patch are read at a
// time and repeated for every output. All sums of a pixel then fit into one vector of 16 lanes or two vectors of 8 lanes. With one vector per
// output, adding up the lanes would take three times as long.
//
// With three outputs, the weights of the fourth output are zero. In fixed point, its intercept is the number of fractional bits of the class.
//
// In floating point, a vector contains only half as many taps. For large patches, the additional reads would cost more than the simpler sums
// over lanes save.

#ifdef SIDE_BY_SIDE

#define AT_ONCE_OUTPUTS (LANES / 4)         // outputs per vector
#define SUMS (4 / AT_ONCE_OUTPUTS)          // vectors for four outputs
#define ONCE (TAP_LANES / AT_ONCE_OUTPUTS)  // taps per output in a vector
#define VECTORS ((TAPS + ONCE - 1) / ONCE)
#define CLASS_STRIDE (TAP_LANES * SUMS * (1 + VECTORS))  // values of type `tap` per class: a header with the intercepts, and the weights
#define PLANES_MADE OUTPUTS
#define READ_AHEAD ONCE

// True if both pixels of a pair have the same class, so that they can share one read of its weights. In fixed-point layers, classes change so often
// that mispredicted branches would cost more time than the shared reads save. These layers therefore always read the weights twice.
#ifdef FIXED_POINT
#define SHARED(class, other) false
#else
#define SHARED(class, other) ((class) == (other))
#endif

typedef tap some_taps __attribute__((ext_vector_type(ONCE), aligned(sizeof(tap))));

#if TAP_LANES == 32
#define REPEATED(v) __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7, \
    0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7)
#elif TAP_LANES == 8
#define REPEATED(v) __builtin_shufflevector(v, v, 0, 1, 2, 3, 0, 1, 2, 3)
#elif defined(FIXED_POINT)
#define REPEATED(v) __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7)
#else
#define REPEATED(v) __builtin_shufflevector(v, v, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#endif

// Multiplies the patches of a pair of pixels by the weights of their classes. The partial sums of both pixels share SUMS vectors.
INLINE void apply_pair(totals sum[SUMS], const tap *first, const tap *second, __global const tap *first_weights,
                       __global const tap *second_weights) {
    totals one[SUMS], other[SUMS];
    #pragma unroll
    for (int s = 0; s < SUMS; s++) {
        one[s] = SAME_BITS(LOAD_GLOBAL(taps, first_weights + s * TAP_LANES), totals);
        other[s] = SAME_BITS(LOAD_GLOBAL(taps, second_weights + s * TAP_LANES), totals);
    }
    #pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        const some_taps u = *(const some_taps *)(first + j * ONCE), v = *(const some_taps *)(second + j * ONCE);
        #pragma unroll
        for (int s = 0; s < SUMS; s++) {
            const int at = ((1 + j) * SUMS + s) * TAP_LANES;
            one[s] = add_products(one[s], REPEATED(u), LOAD_GLOBAL(taps, first_weights + at));
            other[s] = add_products(other[s], REPEATED(v), LOAD_GLOBAL(taps, second_weights + at));
        }
    }
    #pragma unroll
    for (int s = 0; s < SUMS; s++) sum[s] = fold_two(one[s], other[s]);
}

// Sorts groups of four lanes by output, so that output[o] contains output o of LANES pixels.
INLINE void part_outputs(totals output[4], totals folded[SUMS][LANES / 4]) {
#if LANES == 16
    const totals *v = folded[0];
    const totals ab = JOIN(v[0], v[1], 0, 4), cd = JOIN(v[2], v[3], 0, 4), ab_after = JOIN(v[0], v[1], 8, 12);
    const totals cd_after = JOIN(v[2], v[3], 8, 12);
    output[0] = JOIN(ab, cd, 0, 8);
    output[1] = JOIN(ab, cd, 4, 12);
    output[2] = JOIN(ab_after, cd_after, 0, 8);
    output[3] = JOIN(ab_after, cd_after, 4, 12);
#else
    #pragma unroll
    for (int s = 0; s < SUMS; s++) {
        output[2 * s] = __builtin_shufflevector(folded[s][0], folded[s][1], 0, 1, 2, 3, 8, 9, 10, 11);
        output[2 * s + 1] = __builtin_shufflevector(folded[s][0], folded[s][1], 4, 5, 6, 7, 12, 13, 14, 15);
    }
#endif
}

// Computes plane or output o of LANES pixels from column x as made[o].
INLINE void apply(totals *made, const tap *patches, const float *ratios, const uint *label, __global const tap *weights, int x) {
    totals folded[SUMS][LANES / 4], output[4];
    #pragma clang loop unroll_count(UNROLLED)
    for (int n = 0; n < LANES / 2; n += 2) {
        totals pair[2][SUMS];
        #pragma unroll
        for (int i = 0; i < 2; i++) {
            const int first = PAIR_FIRST(n + i), second = first + PAIR;
            const tap *patch = patches + (x + first) * COLUMN;
            const uint class = label[x + first], other = label[x + second];
            __global const tap *row = weights + (size_t)class * CLASS_STRIDE;
            if (SHARED(class, other)) apply_pair(pair[i], patch, patch + PAIR * COLUMN, row, row);
            else apply_pair(pair[i], patch, patch + PAIR * COLUMN, row, weights + (size_t)other * CLASS_STRIDE);
        }
        #pragma unroll
        for (int s = 0; s < SUMS; s++) folded[s][n / 2] = fold_four(pair[0][s], pair[1][s]);
    }
    part_outputs(output, folded);
    #pragma unroll
    for (int o = 0; o < OUTPUTS; o++) {
#ifdef FIXED_POINT
        const totals in_pairs = plane_value(output[o], output[3]);
#else
        const totals in_pairs = output[o];
#endif
        made[o] = __builtin_shufflevector(in_pairs, in_pairs, ALL_LANES(PAIR_PLACE));
    }
}

#endif
