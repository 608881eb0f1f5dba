
/* ---------------------------------------------------------------------------------------------------------- coarse chroma */

#define QUADS(length) (((length) + 1) / 2)
#define BLOCKS(length) QUADS(QUADS(length))
#define STEPS 4

/* Means of 2 x 2 pixels of the planes, quads, and of 2 x 2 quads, blocks; what quads read of blocks. */
typedef struct {
    float *quads;                 /* (plane, quad row, quad column) */
    float *first, *block, *other; /* (plane, block row, block column) after the first step; as they are, then after others */
    float *far;                   /* (first and third plane, share; quad row, quad column) */
    int32_t *sums;                /* (plane, padded column) of planes, down a window */
} CoarseChroma;

static CoarseChroma coarse_in(Room *room, int rows, int columns) {
    const uint64_t quads = 3 * (uint64_t)QUADS(rows) * (uint64_t)QUADS(columns);
    const uint64_t blocks = 3 * (uint64_t)BLOCKS(rows) * (uint64_t)BLOCKS(columns);
    CoarseChroma c;
    c.quads = take(room, quads, sizeof *c.quads);
    c.first = take(room, blocks, sizeof *c.first);
    c.block = take(room, blocks, sizeof *c.block);
    c.other = take(room, blocks, sizeof *c.other);
    c.far = take(room, quads, sizeof *c.far);
    c.sums = take(room, 3 * (uint64_t)(columns + L3_MOST_SIDE), sizeof *c.sums);
    return c;
}

static int least_of(int a, int b) { return a < b ? a : b; }

/* The square of differences of plane s from which on nothing is alike, at luminance y. */
static float scale_of(int compared, int s, float y) {
    const float *terms = l3_coarse_scales + (compared * 3 + s) * 3, above = y > 0 ? y : 0;
    return (terms[2] * above + terms[1]) * above + terms[0];
}

static float likeness(const float difference[3], const float scale[3]) {
    float left = 1;
    for (int s = 0; s < 3; s++) left -= difference[s] * difference[s] / scale[s];
    if (left <= 0) return 0;
    left *= left, left *= left;
    return left * left;
}

/* The means of 2 x 2 values of three planes, the outermost repeated where there is none. */
static void halve_floats(const float *restrict from, int rows, int columns, float *restrict to) {
    for (int s = 0; s < 3; s++, from += (ptrdiff_t)rows * columns)
        for (int y = 0; y < QUADS(rows); y++) {
            const float *above = from + (ptrdiff_t)(2 * y) * columns, *below = from + (ptrdiff_t)least_of(2 * y + 1, rows - 1) * columns;
            for (int x = 0; x < QUADS(columns); x++) {
                const int next = least_of(2 * x + 1, columns - 1);
                *to++ = (above[2 * x] + above[next] + below[2 * x] + below[next]) * 0.25f;
            }
        }
}

static void halve_planes(const int32_t *restrict from, int rows, int columns, float *restrict to) {
    for (int s = 0; s < 3; s++, from += (ptrdiff_t)rows * columns)
        for (int y = 0; y < QUADS(rows); y++) {
            const int32_t *above = from + (ptrdiff_t)(2 * y) * columns;
            const int32_t *below = from + (ptrdiff_t)least_of(2 * y + 1, rows - 1) * columns;
            for (int x = 0; x < QUADS(columns); x++) {
                const int next = least_of(2 * x + 1, columns - 1);
                *to++ = (float)(above[2 * x] + above[next] + below[2 * x] + below[next]) * 0.25f;
            }
        }
}

/* Blocks -> their means over 3 x 3 blocks that far from each other, of those alike. */
static void soften_blocks(const float *restrict from, int step, int rows, int columns, float *restrict to) {
    const ptrdiff_t plane = (ptrdiff_t)rows * columns;
    const int spacing = 1 << step;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            const ptrdiff_t at = (ptrdiff_t)y * columns + x;
            float scale[3], change[3] = {0, 0, 0}, weights = 0.25f;
            for (int s = 0; s < 3; s++) scale[s] = scale_of(step, s, from[L3_LUMINANCE * plane + at]);
            for (int n = 0; n < 9; n++) {
                const int row = y + (n / 3 - 1) * spacing, column = x + (n % 3 - 1) * spacing;
                if (n == 4 || row < 0 || row >= rows || column < 0 || column >= columns) continue;
                float difference[3];
                for (int s = 0; s < 3; s++) difference[s] = from[s * plane + (ptrdiff_t)row * columns + column] - from[s * plane + at];
                const float weight = likeness(difference, scale) * (n % 2 ? 0.125f : 0.0625f);
                weights += weight;
                for (int s = 0; s < 3; s++) change[s] += weight * difference[s];
            }
            for (int s = 0; s < 3; s++) to[s * plane + at] = from[s * plane + at] + change[s] / weights;
        }
}

/* What the quad reads of the four blocks nearest to it. */
static void read_blocks(const CoarseChroma *c, int y, int x, int rows, int columns) {
    const ptrdiff_t plane = (ptrdiff_t)rows * columns, at = (ptrdiff_t)y * columns + x;
    const int block_rows = QUADS(rows), block_columns = QUADS(columns);
    const ptrdiff_t blocks = (ptrdiff_t)block_rows * block_columns;
    float own[3] = {0, 0, 0}, scale[3], total[2] = {0, 0}, weights = 0;
    for (int n = 0; n < 9; n++) {
        const int row = y + n / 3 - 1, column = x + n % 3 - 1;
        const int there = (row < 0 ? 0 : least_of(row, rows - 1)) * columns + (column < 0 ? 0 : least_of(column, columns - 1));
        for (int s = 0; s < 3; s++)
            own[s] += c->quads[s * plane + there]
                    * (s != L3_LUMINANCE ? 1.0f / 9 : n == 4 ? 16.0f / 36 : n % 2 ? 4.0f / 36 : 1.0f / 36);
    }
    for (int s = 0; s < 3; s++) scale[s] = scale_of(STEPS, s, own[L3_LUMINANCE]);
    for (int n = 0; n < 4; n++) {
        const int row = (y + 1) / 2 - 1 + n / 2, column = (x + 1) / 2 - 1 + n % 2;
        if (row < 0 || row >= block_rows || column < 0 || column >= block_columns) continue;
        const ptrdiff_t there = (ptrdiff_t)row * block_columns + column;
        const float down = n / 2 == y % 2 ? 0.25f : 0.75f, across = n % 2 == x % 2 ? 0.25f : 0.75f;
        float difference[3];
        for (int s = 0; s < 3; s++) difference[s] = c->first[s * blocks + there] - own[s];
        const float weight = likeness(difference, scale) * down * across;
        weights += weight;
        for (int i = 0; i < 2; i++) total[i] += weight * c->block[2 * i * blocks + there];
    }
    for (int i = 0; i < 2; i++) c->far[i * plane + at] = total[i] / (weights + L3_COARSE_OWN);
    c->far[2 * plane + at] = weights / (weights + L3_COARSE_OWN);
}

/* Chroma from far around, where pixels are alike, takes the place of that of a last layer's windows. */
static void add_coarse_chroma(const CoarseChroma *c, int side, const int32_t *planes, int rows, int columns, float *outputs) {
    const int quad_rows = QUADS(rows), quad_columns = QUADS(columns), span = columns + side - 1;
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns, quads = (ptrdiff_t)quad_rows * quad_columns;
    halve_planes(planes, rows, columns, c->quads);
    halve_floats(c->quads, quad_rows, quad_columns, c->block);
    soften_blocks(c->block, 0, QUADS(quad_rows), QUADS(quad_columns), c->first);
    soften_blocks(c->first, 1, QUADS(quad_rows), QUADS(quad_columns), c->block);
    soften_blocks(c->block, 2, QUADS(quad_rows), QUADS(quad_columns), c->other);
    soften_blocks(c->other, 3, QUADS(quad_rows), QUADS(quad_columns), c->block);
    for (int y = 0; y < quad_rows; y++)
        for (int x = 0; x < quad_columns; x++) read_blocks(c, y, x, quad_rows, quad_columns);
    for (int y = 0; y < rows; y++) {
        sum_columns(planes, side / 2, y, rows, columns, c->sums);
        for (int x = 0; x < columns; x++) {
            const float *quad = c->far + (ptrdiff_t)(y / 2) * quad_columns + x / 2;
            for (int i = 0; i < 2; i++) {
                int32_t sum = 0;
                for (int p = x; p < x + side; p++) sum += c->sums[2 * i * span + p];
                outputs[2 * i * pixels + (ptrdiff_t)y * columns + x] +=
                    (quad[i * quads] - quad[2 * quads] * (float)sum / (float)(side * side)) * L3_PLANE_STEP;
            }
        }
    }
}
