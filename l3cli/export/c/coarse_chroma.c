
/* ---------------------------------------------------------------------------------------------------------- coarse chroma */

#define BLOCK 4
#define BLOCKS(length) (((length) + BLOCK - 1) / BLOCK)

/* Blocks (plane, block row, block column): means of 4 x 4 pixels of the planes. */
typedef struct {
    float *before;      /* before the first step */
    float *softened[2]; /* after even and after odd steps */
} CoarseChroma;

static CoarseChroma coarse_in(Room *room, int rows, int columns) {
    const uint64_t blocks = 3 * (uint64_t)BLOCKS(rows) * (uint64_t)BLOCKS(columns);
    CoarseChroma c;
    c.before = take(room, blocks, sizeof *c.before);
    for (int i = 0; i < 2; i++) c.softened[i] = take(room, blocks, sizeof *c.softened[i]);
    return c;
}

static int least_of(int a, int b) { return a < b ? a : b; }

/* Averages planes over blocks. The outermost pixels are repeated outside the frame. */
static void average_planes(const int32_t *restrict from, int rows, int columns, float *restrict to) {
    for (int s = 0; s < 3; s++, from += (ptrdiff_t)rows * columns)
        for (int y = 0; y < BLOCKS(rows); y++)
            for (int x = 0; x < BLOCKS(columns); x++) {
                int32_t sum = 0;
                for (int n = 0; n < BLOCK * BLOCK; n++) {
                    const ptrdiff_t row = least_of(BLOCK * y + n / BLOCK, rows - 1);
                    sum += from[row * columns + least_of(BLOCK * x + n % BLOCK, columns - 1)];
                }
                *to++ = (float)sum * (1.0f / (BLOCK * BLOCK));
            }
}

/* Replaces each block with the mean of similar blocks in a grid of 3 x 3 blocks with a spacing of 2^step blocks. */
static void soften_blocks(const float *restrict from, int step, int rows, int columns, float *restrict to) {
    const ptrdiff_t plane = (ptrdiff_t)rows * columns;
    const int spacing = 1 << step;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            const ptrdiff_t at = (ptrdiff_t)y * columns + x;
            const float luminance = from[L3_LUMINANCE * plane + at], above = luminance > 0 ? luminance : 0;
            float scale[3], change[3] = {0, 0, 0}, weights = 0.25f;
            for (int s = 0; s < 3; s++) {
                const float *terms = l3_coarse_scales + (step * 3 + s) * 3;
                scale[s] = (terms[2] * above + terms[1]) * above + terms[0];
            }
            for (int n = 0; n < 9; n++) {
                const int row = y + (n / 3 - 1) * spacing, column = x + (n % 3 - 1) * spacing;
                if (n == 4 || row < 0 || row >= rows || column < 0 || column >= columns) continue;
                float difference[3], alike = 1;
                for (int s = 0; s < 3; s++) {
                    difference[s] = from[s * plane + (ptrdiff_t)row * columns + column] - from[s * plane + at];
                    alike -= difference[s] * difference[s] / scale[s];
                }
                if (alike <= 0) continue;
                alike *= alike, alike *= alike;
                const float weight = alike * alike * (n % 2 ? 0.125f : 0.0625f);
                weights += weight;
                for (int s = 0; s < 3; s++) change[s] += weight * difference[s];
            }
            for (int s = 0; s < 3; s++) to[s * plane + at] = from[s * plane + at] + change[s] / weights;
        }
}

/* Interpolates the difference between the blocks after and before all steps at a pixel. The difference is 0 outside the frame. */
static float change_at(const float *restrict before, const float *restrict after, int y, int x, int rows, int columns) {
    float change = 0;
    for (int n = 0; n < 4; n++) {
        const int row = (y + BLOCK / 2) / BLOCK - 1 + n / 2, column = (x + BLOCK / 2) / BLOCK - 1 + n % 2;
        if (row < 0 || row >= rows || column < 0 || column >= columns) continue;
        const float down = ((float)((y + BLOCK / 2) % BLOCK) + 0.5f) / BLOCK, across = ((float)((x + BLOCK / 2) % BLOCK) + 0.5f) / BLOCK;
        const ptrdiff_t at = (ptrdiff_t)row * columns + column;
        change += (n / 2 ? down : 1 - down) * (n % 2 ? across : 1 - across) * (after[at] - before[at]);
    }
    return change;
}

/* Adds the changes of the two chroma planes to the outputs L3_CHROMA_1 and L3_CHROMA_2. */
static void add_coarse_chroma(const CoarseChroma *c, const int32_t *planes, int rows, int columns, L3Output *outputs) {
    const int block_rows = BLOCKS(rows), block_columns = BLOCKS(columns);
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns, blocks = (ptrdiff_t)block_rows * block_columns;
    const float *after = c->before;
    average_planes(planes, rows, columns, c->before);
    for (int step = 0; step < 4; step++) {
        soften_blocks(after, step, block_rows, block_columns, c->softened[step % 2]);
        after = c->softened[step % 2];
    }
    for (int s = 0; s < 3; s += 2)
        for (int y = 0; y < rows; y++)
            for (int x = 0; x < columns; x++) {
                L3Output *output = outputs + (s ? L3_CHROMA_2 : L3_CHROMA_1) * pixels + (ptrdiff_t)y * columns + x;
                const float change = change_at(c->before + s * blocks, after + s * blocks, y, x, block_rows, block_columns);
                *output = changed(*output, change * L3_PLANE_STEP);
            }
}
