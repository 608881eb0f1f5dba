// Processor variant: computes each channel's sum, sum of squares and saturation over the patch of every pixel.
//
// The sums are separable. Column sums are updated from row to row: the row that enters the patch is added, and the row that leaves the patch is
// subtracted. Both are masked with the channels of their CFA row. Sums over RUN columns are computed once and shared by several patches.

#define RUN (PATCH < 3 ? PATCH : 3)         // columns per shared sum
#define SPREAD (2 * SATURATION_RADIUS + 1)  // rows and columns in which saturation is tested

typedef struct {
    ushort sum[CHANNELS][SPAN];      // over the rows of a patch; at most 15 · 4095
    uint square[CHANNELS][SPAN];     // over the rows of a patch
    ushort saturated[SPREAD][SPAN];  // bit c: the pixel belongs to channel c and is saturated; ring of the latest SPREAD rows
} Columns;

typedef struct {
    uint sum[CHANNELS][SPAN], square[CHANNELS][SPAN];  // over RUN columns, starting at this column
    ushort saturated[SPAN];                            // bitwise or over SPREAD rows of this column
} Runs;

// Masks for a CFA row, with all bits set where pixels belong to channel c.
#define MEMBER(member, c, phase) LOAD_GLOBAL(full_shorts, (member) + (c) * CFA_ROWS * PERIOD + (phase))
#define WIDE_MEMBER(member, c, phase) \
    SAME_BITS(CONVERT(LOAD_GLOBAL(signed_shorts, (member) + (c) * CFA_ROWS * PERIOD + (phase)), ints), uints)

// Adds row `entering` to the column sums, and subtracts row `leaving`.
INLINE void slide(Columns *columns, const ushort *entering, __global const ushort *entering_member, const ushort *leaving,
                  __global const ushort *leaving_member, int phase, int span) {
    for (int p = 0, at = phase; p < span; p += 2 * LANES, at = PHASE_AFTER(at, 2 * LANES)) {
        const full_shorts in = LOAD_PRIVATE(full_shorts, entering + p) >> SHIFT;
        const full_shorts out = LOAD_PRIVATE(full_shorts, leaving + p) >> SHIFT;
        #pragma unroll
        for (int c = 0; c < CHANNELS; c++) {
            const full_shorts change = (in & MEMBER(entering_member, c, at)) - (out & MEMBER(leaving_member, c, at));
            ushort *sum = columns->sum[c] + p;
            STORE_PRIVATE(full_shorts, sum) = LOAD_PRIVATE(full_shorts, sum) + change;
        }
    }
#if CONTRASTS > 1  // a single contrast needs no squares
    for (int p = 0, at = phase; p < span; p += LANES, at = PHASE_AFTER(at, LANES)) {
        const uints in = CONVERT(LOAD_PRIVATE(shorts, entering + p) >> SHIFT, uints);
        const uints out = CONVERT(LOAD_PRIVATE(shorts, leaving + p) >> SHIFT, uints);
        const uints in_square = in * in, out_square = out * out;
        #pragma unroll
        for (int c = 0; c < CHANNELS; c++) {
            const uints change = (in_square & WIDE_MEMBER(entering_member, c, at))
                                 - (out_square & WIDE_MEMBER(leaving_member, c, at));
            uint *square = columns->square[c] + p;
            STORE_PRIVATE(uints, square) = LOAD_PRIVATE(uints, square) + change;
        }
    }
#endif
}

// Marks the saturated pixels in a row. `channel_bit` contains 1 << channel for the CFA row.
INLINE void saturated_row(ushort *saturated, const ushort *row, __global const ushort *channel_bit, int phase, int span) {
    for (int p = 0, at = phase; p < span; p += 2 * LANES, at = PHASE_AFTER(at, 2 * LANES)) {
        const full_shorts v = LOAD_PRIVATE(full_shorts, row + p), bit = LOAD_GLOBAL(full_shorts, channel_bit + at);
#if SATURATION > 0xffff  // no pixel is saturated
        STORE_PRIVATE(full_shorts, saturated + p) = 0;
#else
        STORE_PRIVATE(full_shorts, saturated + p) = v >= (ushort)SATURATION ? bit : (full_shorts)0;
#endif
    }
}

INLINE void add_runs(Runs *runs, const Columns *columns, int span) {
    for (int p = 0; p < span; p += LANES) {
        #pragma unroll
        for (int c = 0; c < CHANNELS; c++) {
            uints sum = 0, square = 0;
            #pragma unroll
            for (int j = 0; j < RUN; j++) {
                sum += CONVERT(LOAD_PRIVATE(shorts, columns->sum[c] + p + j), uints);
#if CONTRASTS > 1
                square += LOAD_PRIVATE(uints, columns->square[c] + p + j);
#endif
            }
            STORE_PRIVATE(uints, runs->sum[c] + p) = sum;
#if CONTRASTS > 1
            STORE_PRIVATE(uints, runs->square[c] + p) = square;
#endif
        }
    }
    for (int p = 0; p < span; p += 2 * LANES) {
        full_shorts channels = 0;
        #pragma unroll
        for (int j = 0; j < SPREAD; j++) channels |= LOAD_PRIVATE(full_shorts, columns->saturated[j] + p);
        STORE_PRIVATE(full_shorts, runs->saturated + p) = channels;
    }
}

// Sums of channel c over the patches that begin at columns p, p + 1 …. They are composed of shared sums over RUN columns, and of the remaining
// columns.
INLINE uints patch_sum(const Runs *runs, const Columns *columns, int c, int p) {
    uints total = LOAD_PRIVATE(uints, runs->sum[c] + p);
    #pragma unroll
    for (int j = RUN; j + RUN <= PATCH; j += RUN) total += LOAD_PRIVATE(uints, runs->sum[c] + p + j);
    #pragma unroll
    for (int j = PATCH / RUN * RUN; j < PATCH; j++) total += CONVERT(LOAD_PRIVATE(shorts, columns->sum[c] + p + j), uints);
    return total;
}

INLINE uints patch_square(const Runs *runs, const Columns *columns, int c, int p) {
    uints total = LOAD_PRIVATE(uints, runs->square[c] + p);
    #pragma unroll
    for (int j = RUN; j + RUN <= PATCH; j += RUN) total += LOAD_PRIVATE(uints, runs->square[c] + p + j);
    #pragma unroll
    for (int j = PATCH / RUN * RUN; j < PATCH; j++) total += LOAD_PRIVATE(uints, columns->square[c] + p + j);
    return total;
}

#ifdef BOX_ROWS
// The windows of all features are boxes of the same size, and many pixels share a box. All boxes with the same last row are summed together.
#if BOX_ROWS * BOX_COLUMNS <= 16  // sums of 12-bit values fit into 16 bits
typedef ushort box;
#define LOAD_BOX(p) CONVERT(LOAD_PRIVATE(shorts, p), ints)
#define BOX_OF(total) CONVERT(total, shorts)
#define STORE_BOX(p) STORE_PRIVATE(shorts, p)
#else
typedef uint box;
#define LOAD_BOX(p) SAME_BITS(LOAD_PRIVATE(uints, p), ints)
#define BOX_OF(total) (total)
#define STORE_BOX(p) STORE_PRIVATE(uints, p)
#endif

// Sums over all boxes with their last row in slot `newest` of the ring. boxes[p] is the sum of the box that begins at column p.
INLINE void add_boxes(box *boxes, ushort ring[PATCH + 1][SPAN], int newest, int span) {
    ushort down[SPAN];
    for (int p = 0; p < span; p += 2 * LANES) {
        full_shorts sum = 0;
        #pragma unroll
        for (int j = 0; j < BOX_ROWS; j++)
            sum += LOAD_PRIVATE(full_shorts, ring[(newest + PATCH + 1 - j) % (PATCH + 1)] + p) >> SHIFT;
        STORE_PRIVATE(full_shorts, down + p) = sum;
    }
    for (int p = span; p < SPAN; p++) down[p] = 0;
    for (int p = 0; p < span; p += LANES) {
        uints total = 0;
        #pragma unroll
        for (int i = 0; i < BOX_COLUMNS; i++) total += CONVERT(LOAD_PRIVATE(shorts, down + p + i), uints);
        STORE_BOX(boxes + p) = BOX_OF(total);
    }
}
#elif defined(EACH_WINDOW)
// Sums over a window in the patches that begin at columns p, p + 1 …. The first row of the patches is in slot `first` of the ring. Row sums fit
// into 16 bits.
INLINE ints window_sum(ushort ring[PATCH + 1][SPAN], int first, int top, int left, int rows, int columns, int p) {
    ints total = (ints)0;
    for (int j = 0; j < rows; j++) {
        const ushort *row = ring[(first + top + j) % (PATCH + 1)] + p + left;
        shorts sum = 0;
        #pragma unroll
        for (int i = 0; i < columns; i++) sum += LOAD_PRIVATE(shorts, row + i) >> SHIFT;
        total += CONVERT(sum, ints);
    }
    return total;
}
#endif

// Channels that saturate near the centres of the patches that begin at columns p, p + 1 …, one bit per channel.
INLINE shorts patch_saturated(const Runs *runs, int p) {
    shorts channels = 0;
    #pragma unroll
    for (int j = RADIUS - SATURATION_RADIUS; j <= RADIUS + SATURATION_RADIUS; j++)
        channels |= LOAD_PRIVATE(shorts, runs->saturated + p + j);
    return channels;
}
