// Processor variant: computes weighted sums over patches in floating-point layers, for any number of outputs.
//
// The side of a patch is odd, so a patch of one plane has 8n + 1 taps. All taps but the last fill VECTORS whole vectors. With 16 lanes, half of
// the weights in the last vector may be zero. The last tap is processed together with the intercept, in a vector of four lanes for all outputs
// in a group.

#ifndef SIDE_BY_SIDE

#define VECTORS ((TAPS - 1 + LANES - 1) / LANES)
#define GROUPS ((OUTPUTS + 3) / 4)               // groups of at most four outputs, so that the sums of a group stay in registers
#define GROUP ((OUTPUTS + GROUPS - 1) / GROUPS)  // outputs per group
#define LAST_TAP (VECTORS * GROUP * LANES)       // offset in a group of the last tap's weights, which precede the intercepts
#ifdef RATIO_TAPS
#define TAPS_OF_RATIOS RATIO_TAPS  // number of ratio taps, with weights after the intercepts
#else
#define TAPS_OF_RATIOS 0
#endif
#define GROUP_STRIDE WHOLE(LAST_TAP + 8 + 4 * TAPS_OF_RATIOS, 16)
#define CLASS_STRIDE (GROUPS * GROUP_STRIDE)
#define PLANES_MADE (GROUPS * GROUP)
#define READ_AHEAD (VECTORS * LANES)  // taps that may be read beyond the end of a patch

// Adds the groups of four lanes within each vector, lane by lane. Group n of the result is the sum for v[n].
INLINE totals fold_all(const totals v[LANES / 4]) {
#if LANES == 16
    const totals ab = JOIN(v[0], v[1], 0, 4) + JOIN(v[0], v[1], 8, 12);
    const totals cd = JOIN(v[2], v[3], 0, 4) + JOIN(v[2], v[3], 8, 12);
    return JOIN(ab, cd, 0, 8) + JOIN(ab, cd, 4, 12);
#else
    return __builtin_shufflevector(v[0], v[1], 0, 1, 2, 3, 8, 9, 10, 11)
         + __builtin_shufflevector(v[0], v[1], 4, 5, 6, 7, 12, 13, 14, 15);
#endif
}

// Returns the initial sums of a pixel: the intercept of output o in lane o, plus the weighted last tap of the window and the weighted ratio
// taps.
INLINE four_totals last_taps(const tap *patch, const float *ratios, __global const tap *weights) {
    four_totals sum = LOAD_GLOBAL(four_totals, weights + LAST_TAP) * patch[TAPS - 1] + LOAD_GLOBAL(four_totals, weights + LAST_TAP + 4);
    #pragma unroll
    for (int i = 0; i < TAPS_OF_RATIOS; i++) sum += LOAD_GLOBAL(four_totals, weights + LAST_TAP + 8 + 4 * i) * ratios[i * SPAN];
    return sum;
}

// Multiplies the patches of a pair of pixels by the weights of their classes. The partial sums of both pixels share one vector per output.
INLINE void apply_pair(totals sum[GROUP], const tap *first, const tap *second, const float *ratios, __global const tap *first_weights,
                       __global const tap *second_weights) {
    const four_totals first_last = last_taps(first, ratios, first_weights);
    const four_totals second_last = last_taps(second, ratios + PAIR, second_weights);
    totals one[GROUP], other[GROUP];
    #pragma unroll
    for (int o = 0; o < GROUP; o++) {
        one[o] = other[o] = (totals)0;
        one[o][o] = first_last[o];
        other[o][o] = second_last[o];
    }
    #pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        const taps u = LOAD_PRIVATE(taps, first + j * LANES), v = LOAD_PRIVATE(taps, second + j * LANES);
        #pragma unroll
        for (int o = 0; o < GROUP; o++) {
            one[o] = add_products(one[o], u, LOAD_GLOBAL(taps, first_weights + (j * GROUP + o) * LANES));
            other[o] = add_products(other[o], v, LOAD_GLOBAL(taps, second_weights + (j * GROUP + o) * LANES));
        }
    }
    #pragma unroll
    for (int o = 0; o < GROUP; o++) sum[o] = fold_two(one[o], other[o]);
}

// Computes the outputs of LANES pixels from column x. Output o of group g is made[g * GROUP + o]. `ratios` contains the ratio taps (tap, column).
INLINE void apply(totals *made, const tap *patches, const float *ratios, const uint *label, __global const tap *weights, int x) {
    for (int g = 0; g < GROUPS; g++) {
        __global const tap *group = weights + g * GROUP_STRIDE;
        totals folded[GROUP][LANES / 4];
        #pragma clang loop unroll_count(UNROLLED)
        for (int n = 0; n < LANES / 2; n += 2) {
            totals pair[2][GROUP];
            #pragma unroll
            for (int i = 0; i < 2; i++) {
                const int first = PAIR_FIRST(n + i), second = first + PAIR;
                const uint class = label[x + first], other = label[x + second];
                const tap *patch = patches + (x + first) * COLUMN;
                __global const tap *row = group + (size_t)class * CLASS_STRIDE;
                const float *its = ratios + x + first;
#ifndef PLANES  // linear outputs are computed equally fast without this branch, and compile faster
                if (class == other)
                    apply_pair(pair[i], patch, patch + PAIR * COLUMN, its, row, row);
                else
#endif
                    apply_pair(pair[i], patch, patch + PAIR * COLUMN, its, row, group + (size_t)other * CLASS_STRIDE);
            }
            #pragma unroll
            for (int o = 0; o < GROUP; o++) folded[o][n / 2] = fold_four(pair[0][o], pair[1][o]);
        }
        #pragma unroll
        for (int o = 0; o < GROUP; o++) {
            const totals in_pairs = fold_all(folded[o]);
            made[g * GROUP + o] = __builtin_shufflevector(in_pairs, in_pairs, ALL_LANES(PAIR_PLACE));
        }
    }
}

#endif
