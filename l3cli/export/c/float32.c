/* ----------------------------------------------------------------------------------------------------------- float outputs */

#if defined L3_BY_LUMINANCE || defined L3_PLANE_STEP || defined L3_CLIP_FAINTEST
/* Returns output + by. */
static inline L3Output changed(L3Output output, float by) { return output + by; }
#endif

#ifdef L3_WHITE_SLOPE
/* Fades the outputs of a pixel that is brighter than the clipped white. X, Y and Z are `apart` values apart in memory. */
static inline void fade_to_white(L3Output *output, ptrdiff_t apart, const L3Output white[3]) {
    const float luminance = output[apart], over = L3_WHITE_SLOPE * (luminance - white[1]) / white[1], faded = over < 1 ? over : 1;
    for (int o = 0; o < 3; o++) output[o * apart] = white[1] / luminance * (1 - faded) * output[o * apart] + faded * white[o];
}
#endif

/* Ring buffer of the values that the last layer reads. */
typedef struct {
    float *value;
} Ring;

static Ring ring_in(Room *room, uint64_t values) {
    Ring ring;
    ring.value = take(room, values, sizeof *ring.value);
    return ring;
}

static inline void keep(const Ring *ring, size_t at, int32_t value) { ring->value[at] = (float)value - L3_VALUE_OFFSET; }
static inline void keep_nothing(const Ring *ring, size_t at) { ring->value[at] = 0; }

/* Computes a sum of products. Sixteen independent partial sums permit compilers to vectorise the loop. */
static inline float dot(const float *restrict a, const float *restrict b, int taps) {
    float part[16] = {0}, eight[8], four[4];
    for (int t = 0; t < taps; t += 16)
        for (int i = 0; i < 16; i++) part[i] += a[t + i] * b[t + i];
    for (int i = 0; i < 8; i++) eight[i] = part[i] + part[i + 8];
    for (int i = 0; i < 4; i++) four[i] = eight[i] + eight[i + 4];
    return (four[0] + four[2]) + (four[1] + four[3]);
}

/* Contribution to an output of the taps after the patch: colour ratios and bilateral chroma. */
typedef float Behind;

/* Computes an output of the patch that begins at ring[at]. `output` is class * L3_OUTPUTS + number of the output. */
static inline L3Output output_of(const Ring *ring, ptrdiff_t at, size_t output, Behind behind) {
    return dot(ring->value + at, l3_last_weights + output * L3_LAST_TAPS, L3_LAST_TAPS) + l3_last_intercept[output] + behind;
}

#if L3_RATIO_TAPS

/* Value of a tap that follows the patch. */
typedef float Chroma;

static inline Chroma quotient(int64_t part, int64_t whole) { return (float)part / (float)whole; }

static inline Behind behind_of(const Chroma chroma[L3_RATIO_TAPS], size_t output) {
    const float *weights = l3_ratio_weights + output * L3_RATIO_TAPS;
    float sum = 0;
    for (int i = 0; i < L3_RATIO_TAPS; i++) sum += weights[i] * chroma[i];
    return sum;
}

#endif
