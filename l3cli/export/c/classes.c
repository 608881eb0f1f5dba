/* ---------------------------------------------------------------------------------------------------------------- classes */

/* Statistics and class features of the patches around the pixels of a block. */
typedef struct {
    uint32_t level_sum[L3_BLOCK];               /* sum of the channel means, times 256 */
    uint32_t variance_sum[L3_BLOCK];            /* sum of the channel variances, times 512 */
    int32_t above_black[L3_CHANNELS][L3_BLOCK]; /* channel means above the black level, times 16 */
    uint32_t level[L3_BLOCK], chroma[L3_BLOCK], combination[L3_BLOCK];
    uint16_t code[L3_BLOCK];                    /* bit c: channel c is saturated near the centre of the patch */
} Evidence;

/* Adds the mean and the variance of channel c, computed from the sums, the sums of squares and the number of its pixels in each patch. */
static void add_evidence(Evidence *restrict e, int c, const uint32_t *restrict sum, const uint32_t *restrict square,
                         const uint32_t *restrict count, const uint32_t *restrict mean_reciprocal,
                         const uint32_t *restrict variance_reciprocal) {
    for (int i = 0; i < L3_BLOCK; i++) {
        const uint32_t scaled = sum[i] * mean_reciprocal[i], mean = scaled >> 16;
        const uint32_t variance = (square[i] - mean * (2 * sum[i] - mean * count[i])) * variance_reciprocal[i];
        e->level_sum[i] += scaled >> 8;
        e->variance_sum[i] += variance < L3_VARIANCE_CAP ? variance : L3_VARIANCE_CAP;
        const int32_t above = (int32_t)(scaled >> 12) - L3_CHROMA_BLACK_LEVEL, positive = above > 0 ? above : 0;
        e->above_black[c][i] = positive < 65535 ? positive : 65535;
    }
}

static void find_levels(Evidence *restrict e) {
    for (int i = 0; i < L3_BLOCK; i++) e->level[i] = 0;
    for (int edge = 0; edge < L3_LEVELS - 1; edge++) {
        const int32_t top = l3_level_tops[edge];
        for (int i = 0; i < L3_BLOCK; i++) e->level[i] += (int32_t)e->level_sum[i] > top;
    }
}

/* Finds the chroma with the lowest score, or the first of several. With dither, some sites use the second-lowest score instead, if both are
 * close. */
static void find_chromas(Evidence *restrict e, const uint32_t *restrict sites) {
    int32_t least[L3_BLOCK], next[L3_BLOCK];
    uint32_t second[L3_BLOCK];
    for (int i = 0; i < L3_BLOCK; i++) least[i] = next[i] = INT32_MAX, e->chroma[i] = second[i] = 0;
    for (uint32_t k = 0; k < L3_CHROMAS; k++)
        for (int i = 0; i < L3_BLOCK; i++) {
            int32_t score = 0;
            for (int c = 0; c < L3_CHANNELS; c++) score += e->above_black[c][i] * l3_chroma_weights[k][c];
            const int nearer = score < least[i];
            second[i] = nearer ? e->chroma[i] : score < next[i] ? k : second[i];
            next[i] = nearer ? least[i] : score < next[i] ? score : next[i];
            e->chroma[i] = nearer ? k : e->chroma[i];
            least[i] = nearer ? score : least[i];
        }
    for (int i = 0; L3_DITHER && i < L3_BLOCK; i++) {
        int32_t sum = 0;
        for (int c = 0; c < L3_CHANNELS; c++) sum += e->above_black[c][i];
        const int32_t turn = 2 * (int32_t)((sites[i] * L3_CHROMA_TURN + L3_CHROMA_TURN / 2) & 255) - 255;
        const int32_t reach = (sum >> 8) * l3_chroma_widths[e->chroma[i]] >> 8;
        if (next[i] - least[i] < reach * (e->chroma[i] < second[i] ? turn : -turn)) e->chroma[i] = second[i];
    }
}

/* Finds the saturated channels near each pixel. `spread` begins at the first column of the patches. */
static void find_codes(Evidence *restrict e, const uint16_t *restrict spread) {
    for (int i = 0; i < L3_BLOCK; i++) e->code[i] = 0;
    for (int j = L3_RADIUS - L3_SATURATION_RADIUS; j <= L3_RADIUS + L3_SATURATION_RADIUS; j++)
        for (int i = 0; i < L3_BLOCK; i++) e->code[i] = (uint16_t)(e->code[i] | spread[i + j]);
}

/* Combines site, level, contrast, combination and kind of pixel i of a block to its class. */
static uint32_t class_of(const Evidence *e, int i, uint32_t site) {
    uint32_t contrast = 0;
    for (int edge = 0; edge < L3_CONTRASTS - 1; edge++) contrast += e->variance_sum[i] > l3_contrast_edges[edge][e->level[i]];
    const uint32_t saturation = l3_case_of_code[e->code[i]];
    const uint32_t kind = saturation > 0 ? L3_CHROMAS - 1 + saturation : e->chroma[i];
    return (((site * L3_LEVELS + e->level[i]) * L3_CONTRASTS + contrast) * L3_COMBINATIONS + e->combination[i]) * L3_KINDS + kind;
}

/* Computes the classes of `width` pixels of row y, starting at column x. `width` is at most L3_BLOCK. */
static void label_block(const Statistics *s, ptrdiff_t span, int y, ptrdiff_t x, int width, int phase_row, int phase_column,
                        uint32_t *labels) {
    const int site_row = (y + phase_row) % L3_CFA_ROWS;
    uint32_t sum[L3_BLOCK], square[L3_BLOCK], sites[L3_BLOCK];
    Evidence e;
    for (int i = 0; i < L3_BLOCK; i++)
        sites[i] = (uint32_t)(site_row * L3_CFA_COLUMNS + (i + phase_column) % L3_CFA_COLUMNS);
    for (int i = 0; i < L3_BLOCK; i++) e.level_sum[i] = e.variance_sum[i] = 0;
    for (int c = 0; c < L3_CHANNELS; c++) {
        const int at = (site_row * L3_CHANNELS + c) * L3_BLOCK;
        add_across(s->sum + c * span + x, sum);
        add_across(s->square + c * span + x, square);
        add_evidence(&e, c, sum, square, s->count + at, s->mean + at, s->variance + at);
    }
    find_levels(&e);
    find_chromas(&e, sites);
    find_codes(&e, s->spread + x);
    find_combinations(s->padded + y * span + x, span, e.level, e.combination);
    for (int i = 0; i < width; i++) labels[i] = class_of(&e, i, sites[i]);
}

/* Computes the classes of the first layer (row, column) from the padded mosaic. */
static void label_mosaic(const Statistics *s, int rows, int columns, int phase_row, int phase_column, uint32_t *labels) {
    const ptrdiff_t span = padded_span(columns);
    lay_out_constants(s, phase_column);
    for (ptrdiff_t p = 0; p < span; p++) s->zeros[p] = 0;
    for (ptrdiff_t p = 0; p < L3_CHANNELS * span; p++) s->sum[p] = s->square[p] = 0;
    for (int k = 0; k < rows + DIAMETER; k++) {
        slide_rows(s, k, span, phase_row, phase_column);
        const int near = k - (L3_RADIUS - L3_SATURATION_RADIUS); /* saturation is tested in fewer rows */
        if (near >= 0) saturate_row(s, near, span, phase_row, phase_column);
        if (k < DIAMETER) continue;
        const int y = k - DIAMETER;
        spread_saturation(s, span);
        for (ptrdiff_t x = 0; x < columns; x += L3_BLOCK) {
            const int width = smaller(L3_BLOCK, columns - (int)x);
            label_block(s, span, y, x, width, phase_row, phase_column, labels + (ptrdiff_t)y * columns + x);
        }
    }
}

