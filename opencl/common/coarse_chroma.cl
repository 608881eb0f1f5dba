// Coarse chroma (l3cli/classes/coarse_chroma.py): quads, means of 2 × 2 pixels of three planes, with a column of the outermost on
// either side; blocks, of 2 × 2 quads, with MARGIN about them that is FAR from all; and what quads read of these. Rows have room
// behind them that vectors may read.

#define HALF(length) (((length) + 1) / 2)
#define QUADS_STRIDE(columns) (HALF(columns) + 2 + 16)
#define QUADS_PLANE(rows, columns) ((size_t)HALF(rows) * QUADS_STRIDE(columns))
#define BLOCKS_STRIDE(columns) (HALF(HALF(columns)) + 2 * MARGIN + 16)
#define BLOCKS_PLANE(rows, columns) ((size_t)(HALF(HALF(rows)) + 2 * MARGIN) * BLOCKS_STRIDE(columns))

// Of differences from planes at luminance y.
INLINE void inverse_scales(floats inverse[3], __global const float *scale, floats y) {
    const floats above = y > 0.0f ? y : (floats)0.0f;
    #pragma unroll
    for (int s = 0; s < 3; s++) inverse[s] = 1.0f / ((scale[3 * s + 2] * above + scale[3 * s + 1]) * above + scale[3 * s]);
}

INLINE floats likeness(const floats d[3], const floats inverse[3]) {
    const floats left = 1.0f - (d[0] * d[0] * inverse[0] + d[1] * d[1] * inverse[1] + d[2] * d[2] * inverse[2]);
    const floats positive = left > 0.0f ? left : (floats)0.0f, square = positive * positive, fourth = square * square;
    return fourth * fourth;
}

// Of nine neighbours n of a block, itself the fifth.
#define STEP_WEIGHT(n) ((n) == 4 ? 0.25f : (n) % 2 ? 0.125f : 0.0625f)

// Quad i of a row or column lies between blocks NEAREST(i) and the next, this near to it.
#define NEAREST(i) (((i) + 1) / 2 - 1)
#define NEXT_SHARE(i) ((i) % 2 ? 0.25f : 0.75f)
