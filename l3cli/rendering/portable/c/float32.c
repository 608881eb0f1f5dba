/* --------------------------------------------------------------------------------------------------------- words of outputs */

/* What the last layer reads, as it lies in a ring. */
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

/* Sum of products, in sixteen parts that do not wait for one another. */
static inline float dot(const float *restrict a, const float *restrict b) {
    float part[16] = {0}, eight[8], four[4];
    for (int t = 0; t < L3_LAST_TAPS; t += 16)
        for (int i = 0; i < 16; i++) part[i] += a[t + i] * b[t + i];
    for (int i = 0; i < 8; i++) eight[i] = part[i] + part[i + 8];
    for (int i = 0; i < 4; i++) four[i] = eight[i] + eight[i + 4];
    return (four[0] + four[2]) + (four[1] + four[3]);
}

/* The output numbered class * L3_OUTPUTS + output, of the patch that begins at ring[at]. */
static inline L3Output output_of(const Ring *ring, ptrdiff_t at, size_t output) {
    return dot(ring->value + at, l3_last_weights + output * L3_LAST_TAPS) + l3_last_intercept[output];
}

