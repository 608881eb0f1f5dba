// Processor variant: computes the last layer's ratio taps for one row of a tile (l3cli/classes/refinement.py). The first two taps are the
// chroma differences that a change in illumination alone would cause. If RATIO_TAPS is 4, the other two taps are the chroma of similar pixels.

#if SOURCES > 1
typedef struct {
    tap of[SOURCES][SPAN];  // a row of each plane
} Row;
#endif

#ifdef RATIO_TAPS
#define ROWS_KEPT PATCH
#define BEHIND behind[0]

INLINE floats ratio_of(floats luminance, floats total) {
    const float count = PATCH * PATCH;
    const floats least = count * DARKEST, share = (count * luminance - total) / (total > least ? total : least);
    const floats below = share < 1.0f ? share : (floats)1.0f;
    return below > -1.0f ? below : (floats)-1.0f;
}

// Computes tap t of column x as to[t][x]. The window consists of the PATCH stored rows, starting with row[first % PATCH].
INLINE void taps_behind(float (*to)[SPAN], const Row *row, int first, int width) {
    const Row *r[PATCH];
    float sum[SOURCES][SPAN];  // column sums over the rows of the window
    for (int j = 0; j < PATCH; j++) r[j] = row + (first + j) % PATCH;
    for (int s = 0; s < SOURCES; s++)
        for (int p = 0; p < WHOLE(width, LANES) + 2 * RADIUS; p += LANES) {
            floats column = 0;
            #pragma unroll
            for (int j = 0; j < PATCH; j++) column += LOAD_PRIVATE(floats, r[j]->of[s] + p);
            STORE_PRIVATE(floats, sum[s] + p) = column;
        }
    for (int x = 0; x < width; x += LANES) {
        floats total[SOURCES], own[SOURCES];
        #pragma unroll
        for (int s = 0; s < SOURCES; s++) {
            own[s] = LOAD_PRIVATE(floats, r[RADIUS]->of[s] + x + RADIUS);
            total[s] = 0;
            #pragma unroll
            for (int i = 0; i < PATCH; i++) total[s] += LOAD_PRIVATE(floats, sum[s] + x + i);
        }
        const floats share = ratio_of(own[LUMINANCE], total[LUMINANCE]) * (1.0f / (PATCH * PATCH));
        STORE_PRIVATE(floats, to[0] + x) = total[0] * share;
        STORE_PRIVATE(floats, to[1] + x) = total[SOURCES - 1] * share;
#if RATIO_TAPS > 2
        floats square[PATCH * PATCH], reach = 0, weights = 0, sums[2] = {0};
        #pragma unroll
        for (int n = 0; n < PATCH * PATCH; n++) {
            square[n] = 0;
            #pragma unroll
            for (int s = 0; s < SOURCES; s++) {
                const floats away = LOAD_PRIVATE(floats, r[n / PATCH]->of[s] + x + n % PATCH) - own[s];
                square[n] += away * away;
            }
            reach += square[n];
        }
        reach = reach * (1.0f / (PATCH * PATCH)) + (float)DARKEST * DARKEST;
        #pragma unroll
        for (int n = 0; n < PATCH * PATCH; n++) {
            const floats left = reach - square[n], within = left > 0.0f ? left : (floats)0.0f, weight = within * within;
            weights += weight;
            #pragma unroll
            for (int c = 0; c < 2; c++) sums[c] += weight * LOAD_PRIVATE(floats, r[n / PATCH]->of[2 * c] + x + n % PATCH);
        }
        #pragma unroll
        for (int c = 0; c < 2; c++) STORE_PRIVATE(floats, to[2 + c] + x) = sums[c] / weights - own[2 * c];
#endif
    }
}
#else
#define ROWS_KEPT 1
#define BEHIND 0
#endif
