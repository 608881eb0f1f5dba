/* Computes classes and outputs from a raw mosaic. l3_table.h contains the constants, l3_table.c the arrays, and README.md the formulas.
 *
 * The order of this file is: borders, statistics of patches, classes, transforms, l3_render. Classes are computed with 32-bit integers
 * and are therefore the same on every processor. Loops over pixels process whole blocks of L3_BLOCK pixels. L3_BLOCK is a multiple of
 * the columns of the CFA. Constants that alternate along a row can therefore be stored as arrays, and compilers vectorise every loop.
 *
 * Right shifts of negative numbers must be arithmetic, as in all common compilers. */
#include "l3.h"

#define DIAMETER (2 * L3_RADIUS)                   /* total number of padding rows (or columns) on both sides */
#define SPREAD (2 * L3_SATURATION_RADIUS + 1)      /* number of rows (or columns) in which saturation is tested */
#define SITES (L3_CFA_ROWS * L3_CFA_COLUMNS)
#define MASKS (L3_BLOCK + L3_CFA_COLUMNS)          /* length of a mask, from which a block can be read at any CFA phase */

static int smaller(int a, int b) { return a < b ? a : b; }
static int clamped(int value, int least, int most) { return value < least ? least : value > most ? most : value; }
static int modulo(int value, int period) { return (value % period + period) % period; }

/* ---------------------------------------------------------------------------------------------------------------- borders */

/* Returns the index of the sample to use in place of sample `wanted`: the sample of the same CFA phase nearest to the mirror image. */
static int mirrored(int wanted, int length, int period) {
    if (length < period) return clamped(wanted, 0, length - 1);
    int mirror = wanted < 0 ? -wanted : wanted >= length ? 2 * (length - 1) - wanted : wanted;
    mirror = clamped(mirror, 0, length - 1);
    const int offset = modulo(wanted - mirror, period), below = mirror + offset - period, above = mirror + offset;
    const int prefer_below = above >= length || (below >= 0 && offset > 0 && mirror - below <= above - mirror);
    return prefer_below ? below : above;
}

static uint16_t within_range(uint32_t dn) { return (uint16_t)(dn < L3_MOST_DN ? dn : L3_MOST_DN); }

/* Copies the mosaic with L3_RADIUS additional pixels on every side. `span` is the length of a padded row, which ends with zeros. */
static void pad_mosaic(const uint16_t *restrict raw, int rows, int columns, ptrdiff_t span, uint16_t *restrict padded) {
    for (int r = 0; r < rows + DIAMETER; r++) {
        const uint16_t *restrict from = raw + (ptrdiff_t)mirrored(r - L3_RADIUS, rows, L3_CFA_ROWS) * columns;
        uint16_t *restrict to = padded + r * span;
        for (int p = 0; p < L3_RADIUS; p++) {
            to[p] = within_range(from[mirrored(p - L3_RADIUS, columns, L3_CFA_COLUMNS)]);
            to[columns + L3_RADIUS + p] = within_range(from[mirrored(columns + p, columns, L3_CFA_COLUMNS)]);
        }
        for (int c = 0; c < columns; c++) to[L3_RADIUS + c] = within_range(from[c]);
        for (ptrdiff_t p = columns + DIAMETER; p < span; p++) to[p] = 0;
    }
}

/* -------------------------------------------------------------------------------------------------------------- workspace */

/* Divides the workspace into arrays whose sizes are multiples of 64 bytes. If `base` is NULL, only the size is computed. */
typedef struct {
    unsigned char *base;
    uint64_t used; /* bytes */
} Room;

static void *take(Room *room, uint64_t count, uint64_t bytes) {
    const uint64_t at = room->used;
    room->used += (count * bytes + 63) / 64 * 64;
    return room->base ? room->base + (size_t)at : NULL;
}

/* Number of columns in all blocks of a row, and length of a padded row. */
static ptrdiff_t whole_blocks(int columns) { return (columns + (ptrdiff_t)L3_BLOCK - 1) / L3_BLOCK * L3_BLOCK; }
static ptrdiff_t padded_span(int columns) { return whole_blocks(columns) + L3_BLOCK; }

typedef struct {
    uint16_t *padded;    /* (row + DIAMETER, span) padded mosaic, DN */
    uint16_t *zeros;     /* (span) stands for the rows above the first patches */
    uint32_t *sum;       /* (channel, span) sums of v = DN >> L3_SHIFT over the rows of the patch */
    uint32_t *square;    /* (channel, span) sums of v * v over the rows of the patch */
    uint16_t *saturated; /* (SPREAD, span) bit c: the pixel belongs to channel c and is saturated; ring of the latest rows */
    uint16_t *spread;    /* (span) bitwise or of these rows */
    uint32_t *member;    /* (channel, CFA row, MASKS) all bits set if the pixel belongs to the channel */
    uint16_t *bit;       /* (CFA row, MASKS) 1 << channel */
    uint32_t *count, *mean, *variance; /* (CFA row, channel, L3_BLOCK) number of taps of the channel in the patch of each pixel of a
                                          block, and the reciprocals for mean and variance */
} Statistics;

static Statistics statistics_in(Room *room, int rows, int columns) {
    const uint64_t span = (uint64_t)padded_span(columns);
    Statistics s;
    s.padded = take(room, span * (uint64_t)(rows + DIAMETER), sizeof *s.padded);
    s.zeros = take(room, span, sizeof *s.zeros);
    s.sum = take(room, span * L3_CHANNELS, sizeof *s.sum);
    s.square = take(room, span * L3_CHANNELS, sizeof *s.square);
    s.saturated = take(room, span * SPREAD, sizeof *s.saturated);
    s.spread = take(room, span, sizeof *s.spread);
    s.member = take(room, L3_CHANNELS * L3_CFA_ROWS * MASKS, sizeof *s.member);
    s.bit = take(room, L3_CFA_ROWS * MASKS, sizeof *s.bit);
    s.count = take(room, L3_CFA_ROWS * L3_CHANNELS * L3_BLOCK, sizeof *s.count);
    s.mean = take(room, L3_CFA_ROWS * L3_CHANNELS * L3_BLOCK, sizeof *s.mean);
    s.variance = take(room, L3_CFA_ROWS * L3_CHANNELS * L3_BLOCK, sizeof *s.variance);
    return s;
}

/* Repeats the constants of the CFA along a row, so that a block can read them in sequence. */
static void lay_out_constants(const Statistics *s, int phase_column) {
    for (int row = 0; row < L3_CFA_ROWS; row++) {
        for (int i = 0; i < MASKS; i++) s->bit[row * MASKS + i] = (uint16_t)(1u << l3_cfa[row][i % L3_CFA_COLUMNS]);
        for (int c = 0; c < L3_CHANNELS; c++) {
            for (int i = 0; i < MASKS; i++)
                s->member[(c * L3_CFA_ROWS + row) * MASKS + i] = l3_cfa[row][i % L3_CFA_COLUMNS] == c ? UINT32_MAX : 0;
            for (int i = 0; i < L3_BLOCK; i++) {
                const int site = row * L3_CFA_COLUMNS + (i + phase_column) % L3_CFA_COLUMNS;
                const int at = (row * L3_CHANNELS + c) * L3_BLOCK + i;
                s->count[at] = l3_count[site][c];
                s->mean[at] = l3_mean_reciprocal[site][c];
                s->variance[at] = l3_variance_reciprocal[site][c];
            }
        }
    }
}

/* -------------------------------------------------------------------------------------------------- sums over the patches */

/* Updates the column sums of one channel in one block: adds the entering row and subtracts the leaving row. */
static void slide(uint32_t *restrict sum, uint32_t *restrict square, const uint16_t *restrict entering,
                  const uint32_t *restrict entering_member, const uint16_t *restrict leaving,
                  const uint32_t *restrict leaving_member) {
    for (int i = 0; i < L3_BLOCK; i++) {
        const uint32_t in = (uint32_t)(entering[i] >> L3_SHIFT) & entering_member[i];
        const uint32_t out = (uint32_t)(leaving[i] >> L3_SHIFT) & leaving_member[i];
        sum[i] += in - out;
        square[i] += in * in - out * out;
    }
}

/* Adds padded row k to the column sums of all channels, and subtracts row k - L3_PATCH. */
static void slide_rows(const Statistics *s, int k, ptrdiff_t span, int phase_row, int phase_column) {
    const uint16_t *entering = s->padded + k * span, *leaving = k < L3_PATCH ? s->zeros : entering - L3_PATCH * span;
    const int in_row = modulo(k - L3_RADIUS + phase_row, L3_CFA_ROWS);
    const int out_row = modulo(k - L3_PATCH - L3_RADIUS + phase_row, L3_CFA_ROWS);
    const int first = modulo(phase_column - L3_RADIUS, L3_CFA_COLUMNS);
    for (int c = 0; c < L3_CHANNELS; c++) {
        const uint32_t *in_member = s->member + (c * L3_CFA_ROWS + in_row) * MASKS + first;
        const uint32_t *out_member = s->member + (c * L3_CFA_ROWS + out_row) * MASKS + first;
        for (ptrdiff_t p = 0; p < span; p += L3_BLOCK)
            slide(s->sum + c * span + p, s->square + c * span + p, entering + p, in_member, leaving + p, out_member);
    }
}

/* Marks the saturated pixels of padded row k in the ring of the latest SPREAD rows. */
static void saturate_row(const Statistics *s, int k, ptrdiff_t span, int phase_row, int phase_column) {
    const uint16_t *restrict row = s->padded + k * span;
    const uint16_t *restrict bit = s->bit + modulo(k - L3_RADIUS + phase_row, L3_CFA_ROWS) * MASKS
                                   + modulo(phase_column - L3_RADIUS, L3_CFA_COLUMNS);
    uint16_t *restrict to = s->saturated + k % SPREAD * span;
    for (ptrdiff_t p = 0; p < span; p += L3_BLOCK)
        for (int i = 0; i < L3_BLOCK; i++) {
            const int32_t dn = row[p + i];
            to[p + i] = (uint16_t)(dn >= L3_SATURATION ? bit[i] : 0);
        }
}

/* Combines the latest SPREAD rows with a bitwise or. */
static void spread_saturation(const Statistics *s, ptrdiff_t span) {
    uint16_t *restrict to = s->spread;
    for (ptrdiff_t p = 0; p < span; p++) to[p] = 0;
    for (int j = 0; j < SPREAD; j++) {
        const uint16_t *restrict from = s->saturated + j * span;
        for (ptrdiff_t p = 0; p < span; p++) to[p] = (uint16_t)(to[p] | from[p]);
    }
}

#define RUN (L3_PATCH < 3 ? L3_PATCH : 3)

/* Adds L3_PATCH column sums, starting at each column of a block. Sums of three columns are computed once and shared. The remaining
 * columns are added individually. */
static void add_across(const uint32_t *restrict column, uint32_t *restrict total) {
    uint32_t run[L3_BLOCK + L3_PATCH];
    for (int i = 0; i < L3_BLOCK + L3_PATCH - RUN; i++) {
        uint32_t sum = column[i];
        for (int j = 1; j < RUN; j++) sum += column[i + j];
        run[i] = sum;
    }
    for (int i = 0; i < L3_BLOCK; i++) {
        uint32_t sum = run[i];
        for (int j = RUN; j + RUN <= L3_PATCH; j += RUN) sum += run[i + j];
        for (int j = L3_PATCH / RUN * RUN; j < L3_PATCH; j++) sum += column[i + j];
        total[i] = sum;
    }
}

