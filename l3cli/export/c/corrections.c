
/* Computes the outputs of the first layer from the padded mosaic, and adds them to the corrections that the last layer computed. */
static void add_first_outputs(const Ring *ring, size_t ring_values, const uint16_t *restrict padded, int rows, int columns,
                              const uint32_t *restrict labels, L3Output *restrict outputs) {
    const ptrdiff_t span = padded_span(columns), pixels = (ptrdiff_t)rows * columns;
    for (size_t i = 0; i < ring_values; i++) keep_nothing(ring, i);
    for (int k = 0; k < rows + DIAMETER; k++) {
        const uint16_t *restrict row = padded + k * span;
        for (int p = 0; p < columns + DIAMETER; p++) ring->value[(ptrdiff_t)p * L3_PATCH + k] = (float)row[p] - L3_BLACK_LEVEL;
        if (k < DIAMETER) continue;
        const ptrdiff_t at = (ptrdiff_t)(k - DIAMETER) * columns;
        for (int x = 0; x < columns; x++)
            for (size_t o = 0; o < L3_OUTPUTS; o++) {
                const size_t output = (size_t)labels[at + x] * L3_OUTPUTS + o;
                const float *patch = ring->value + (ptrdiff_t)x * L3_PATCH + k - DIAMETER;
                outputs[(ptrdiff_t)o * pixels + at + x] +=
                    dot(patch, l3_first_weights + output * L3_TAPS, L3_TAPS) + l3_first_intercept[output];
            }
    }
}
