/* -------------------------------------------------------------------------------------------------------------- direction */

/* Along which axis a patch varies (README.md, "Direction"), by the sizes of four differences of sums over boxes, of one block. */
static void find_directions(int32_t size[4][L3_BLOCK], const uint32_t *restrict level, uint32_t *restrict further) {
    for (int i = 0; i < L3_BLOCK; i++) {
        const int32_t a = size[0][i], b = size[1][i], c = size[2][i], d = size[3][i];
        const int32_t ab = a > b ? a : b, cd = c > d ? c : d, largest = ab > cd ? ab : cd;
        const uint32_t steepest = a == largest ? 0u : b == largest ? 1u : c == largest ? 2u : 3u; /* the first of equals */
        const int32_t opposite = a == largest ? c : b == largest ? d : c == largest ? a : b;
        const int32_t after = a == largest ? b : b == largest ? c : c == largest ? d : a;
        const int32_t before = a == largest ? d : b == largest ? a : c == largest ? b : c;
        uint32_t strength = 0;
        for (int s = 0; s < L3_DIRECTION_STRENGTHS; s++) strength += largest > l3_direction_edges[s][level[i]];
        uint32_t group = strength - 1, orientation = steepest;
        if (L3_DIRECTION_COHERENCE > 0)
            group = 2 * group + (L3_DIRECTION_SHARES * opposite <= L3_DIRECTION_COHERENCE * largest);
        if (L3_DIRECTION_ORIENTATIONS == 8) orientation = 2 * steepest + (after > before);
        further[i] = strength == 0 ? 0 : 1 + group * L3_DIRECTION_ORIENTATIONS + orientation;
    }
}

/* Further features of one block: `rows` is the first row and column of its patches. Windows stand from top to bottom: those of equal
 * rows share the sums down their columns. */
static void further_features(const uint16_t *rows, ptrdiff_t span, const uint32_t *restrict level, uint32_t *restrict further) {
    int32_t difference[4][L3_BLOCK], down[L3_BLOCK + L3_PATCH];
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < L3_BLOCK; i++) difference[k][i] = 0;
    for (int w = 0; w < L3_WINDOWS; w++) {
        const L3Window *window = l3_windows + w;
        if (w == 0 || window->top != window[-1].top || window->rows != window[-1].rows) {
            for (int i = 0; i < L3_BLOCK + L3_PATCH - 1; i++) down[i] = 0;
            for (int r = 0; r < window->rows; r++) {
                const uint16_t *restrict v = rows + (window->top + r) * span;
                for (int i = 0; i < L3_BLOCK + L3_PATCH - 1; i++) down[i] += v[i] >> L3_SHIFT;
            }
        }
        int32_t *restrict to = difference[window->sum];
        const int32_t sign = window->sign;
        for (int c = 0; c < window->columns; c++)
            for (int i = 0; i < L3_BLOCK; i++) to[i] += sign * down[window->left + c + i];
    }
    for (int k = 0; k < 4; k++) {
        const int32_t unit = k % 2 ? L3_DIRECTION_DIAGONAL : L3_DIRECTION_STRAIGHT;
        for (int i = 0; i < L3_BLOCK; i++) {
            const int32_t value = difference[k][i], size = value < 0 ? -value : value;
            difference[k][i] = size * unit;
        }
    }
    find_directions(difference, level, further);
}

