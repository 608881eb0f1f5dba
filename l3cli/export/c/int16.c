/* ---------------------------------------------------------------------------------------------------------- 16-bit outputs */

#if defined L3_BY_LUMINANCE || defined L3_PLANE_STEP || defined L3_CLIP_FAINTEST
/* Adds `by`, in the output unit, to an output. */
static inline L3Output changed(L3Output output, float by) {
    const float steps = by * (1 << L3_OUTPUT_FRACTION);
    return (L3Output)clamped(output + (int)(steps < 0 ? steps - 0.5f : steps + 0.5f), -L3_OUTPUT_TOP, L3_OUTPUT_TOP);
}
#endif

#ifdef L3_WHITE_SLOPE
#define ONE (1 << 15) /* a factor of 1 in fixed point */

/* Fades the outputs of a pixel that is brighter than the clipped white. The distance between X, Y and Z in memory is `apart`. */
static inline void fade_to_white(L3Output *output, ptrdiff_t apart, const L3Output white[3]) {
    const int32_t limit = white[1], luminance = output[apart], over = L3_WHITE_SLOPE * (luminance - limit);
    const int32_t faded = over < limit ? over * ONE / limit : ONE;
    for (int o = 0; o < 3; o++) {
        const int64_t scaled = (int64_t)limit * (ONE - faded) * output[o * apart] / luminance;
        output[o * apart] = (L3Output)((scaled + (int64_t)faded * white[o] + ONE / 2) >> 15);
    }
}
#endif

/* Ring buffer of the values that the last layer reads. Value - L3_VALUE_OFFSET = high * 2^L3_SPLIT + low. Both parts have 16 bits, so
 * that the sums of products fit 32 bits. If L3_SPLIT is 0, there is no low part. */
typedef struct {
    int16_t *high, *low;
} Ring;

static Ring ring_in(Room *room, uint64_t values) {
    Ring ring;
    ring.high = take(room, values, sizeof *ring.high);
    ring.low = take(room, L3_SPLIT > 0 ? values : 0, sizeof *ring.low);
    return ring;
}

static inline void keep(const Ring *ring, size_t at, int32_t value) {
    const int32_t signed_value = value - L3_VALUE_OFFSET;
    ring->high[at] = (int16_t)(signed_value >> L3_SPLIT);
    if (L3_SPLIT > 0) ring->low[at] = (int16_t)(signed_value & ((1 << L3_SPLIT) - 1));
}

static inline void keep_nothing(const Ring *ring, size_t at) {
    ring->high[at] = 0;
    if (L3_SPLIT > 0) ring->low[at] = 0;
}

static inline int32_t dot(const int16_t *restrict a, const int16_t *restrict b) {
    int32_t sum = 0;
    for (int t = 0; t < L3_LAST_TAPS; t++) sum += a[t] * b[t];
    return sum;
}

/* Contribution of the taps that follow the patch to a sum of products. */
typedef int32_t Behind;

/* Computes an output of the patch that begins at ring[at]. `output` is class * L3_OUTPUTS + number of the output. */
static inline L3Output output_of(const Ring *ring, ptrdiff_t at, size_t output, Behind behind) {
    const int16_t *weights = l3_last_weights + output * L3_LAST_TAPS;
    const int32_t rest = l3_last_rest[output]; /* excess of the largest weight over 16 bits */
    const ptrdiff_t its = at + l3_last_tap[output];
    int32_t sum = dot(ring->high + at, weights) + rest * ring->high[its] + l3_last_intercept[output] + behind;
    if (L3_SPLIT > 0) sum += (dot(ring->low + at, weights) + rest * ring->low[its]) >> L3_SPLIT;
    const int shift = l3_last_shift[output];
    return (L3Output)clamped((sum + (1 << shift >> 1)) >> shift, -L3_OUTPUT_TOP, L3_OUTPUT_TOP);
}

#if L3_RATIO_TAPS

/* Value of a tap that follows the patch. */
typedef int32_t Chroma;

static inline Chroma quotient(int64_t part, int64_t whole) { return (int32_t)(part / whole); }

static inline Behind behind_of(const Chroma chroma[L3_RATIO_TAPS], size_t output) {
    const int16_t *weights = l3_ratio_weights + output * L3_RATIO_TAPS;
    int32_t high = 0, low = 0;
    for (int i = 0; i < L3_RATIO_TAPS; i++) {
        high += weights[i] * (chroma[i] >> L3_SPLIT);
        low += weights[i] * (chroma[i] & ((1 << L3_SPLIT) - 1));
    }
    return high + (low >> L3_SPLIT);
}

#endif
