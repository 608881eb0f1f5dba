#ifdef __GNUC__
#pragma GCC diagnostic pop
#endif

/* Finds the combination of feature values for each pixel of a block. `rows` points to the first row and column of the patches. The
 * windows are sorted from top to bottom, and consecutive windows with the same rows share their column sums. */
static void find_combinations(const uint16_t *rows, ptrdiff_t span, const uint32_t *restrict level,
                              uint32_t *restrict combination) {
    int32_t sum[L3_WINDOW_SUMS][L3_BLOCK], down[L3_BLOCK + L3_PATCH];
    for (int k = 0; k < L3_WINDOW_SUMS; k++)
        for (int i = 0; i < L3_BLOCK; i++) sum[k][i] = 0;
    for (int w = 0; w < L3_WINDOWS; w++) {
        const L3Window *window = l3_windows + w;
        if (w == 0 || window->top != window[-1].top || window->rows != window[-1].rows) {
            for (int i = 0; i < L3_BLOCK + L3_PATCH - 1; i++) down[i] = 0;
            for (int r = 0; r < window->rows; r++) {
                const uint16_t *restrict v = rows + (window->top + r) * span;
                for (int i = 0; i < L3_BLOCK + L3_PATCH - 1; i++) down[i] += v[i] >> L3_SHIFT;
            }
        }
        int32_t *restrict to = sum[window->sum];
        const int32_t sign = window->sign;
        for (int c = 0; c < window->columns; c++)
            for (int i = 0; i < L3_BLOCK; i++) to[i] += sign * down[window->left + c + i];
    }
    for (int i = 0; i < L3_BLOCK; i++) {
        int32_t own[L3_WINDOW_SUMS];
        for (int k = 0; k < L3_WINDOW_SUMS; k++) own[k] = sum[k][i];
        combination[i] = combination_of(own, level[i], l3_feature_constants);
    }
}

