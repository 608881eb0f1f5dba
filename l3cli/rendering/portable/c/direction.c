/* -------------------------------------------------------------------------------------------------------------- direction */

/* Along which axis a patch varies (README.md, "Direction"), by four differences of sums over boxes. */
static uint32_t direction_of(const int32_t difference[4], uint32_t level) {
    int32_t size[4];
    for (int k = 0; k < 4; k++)
        size[k] = (difference[k] < 0 ? -difference[k] : difference[k]) * (k % 2 ? L3_DIRECTION_DIAGONAL : L3_DIRECTION_STRAIGHT);
    uint32_t steepest = 0, strength = 0;
    for (uint32_t k = 1; k < 4; k++) steepest = size[k] > size[steepest] ? k : steepest;
    for (int s = 0; s < L3_DIRECTION_STRENGTHS; s++) strength += size[steepest] > l3_direction_edges[s][level];
    if (strength == 0) return 0;
    uint32_t group = strength - 1, orientation = steepest;
    if (L3_DIRECTION_COHERENCE > 0)
        group = 2 * group + (L3_DIRECTION_SHARES * size[(steepest + 2) % 4] <= L3_DIRECTION_COHERENCE * size[steepest]);
    if (L3_DIRECTION_ORIENTATIONS == 8) orientation = 2 * steepest + (size[(steepest + 1) % 4] > size[(steepest + 3) % 4]);
    return 1 + group * L3_DIRECTION_ORIENTATIONS + orientation;
}

/* Further features of one block: `rows` is the first row and column of its patches. */
static void further_features(const uint16_t *rows, ptrdiff_t span, const uint32_t *restrict level, uint32_t *restrict further) {
    int32_t difference[4][L3_BLOCK];
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < L3_BLOCK; i++) difference[k][i] = 0;
    for (int w = 0; w < L3_WINDOWS; w++) {
        const L3Window *window = l3_windows + w;
        int32_t *restrict to = difference[window->sum];
        for (int r = 0; r < window->rows; r++)
            for (int c = 0; c < window->columns; c++) {
                const uint16_t *restrict v = rows + (window->top + r) * span + window->left + c;
                for (int i = 0; i < L3_BLOCK; i++) to[i] += window->sign * (v[i] >> L3_SHIFT);
            }
    }
    for (int i = 0; i < L3_BLOCK; i++) {
        const int32_t at[4] = {difference[0][i], difference[1][i], difference[2][i], difference[3][i]};
        further[i] = direction_of(at, level[i]);
    }
}

