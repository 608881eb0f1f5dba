// Coarse chroma (l3cli/classes/coarse_chroma.py). A block contains the mean of 4 × 4 pixels in each of three planes. The blocks are
// surrounded by a MARGIN whose values are not similar to any block. Rows are longer than needed, so that vectors may read beyond the last block.

#define BLOCKS(length) (((length) + 3) / 4)
#define BLOCKS_STRIDE(columns) (BLOCKS(columns) + 2 * MARGIN + 16)
#define BLOCKS_PLANE(rows, columns) ((size_t)(BLOCKS(rows) + 2 * MARGIN) * BLOCKS_STRIDE(columns))

// Reciprocal of the squared difference beyond which two blocks are not similar, for each plane at luminance y.
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

// Weight of block n of the 3 × 3 blocks around a block. The block itself is number 4.
#define STEP_WEIGHT(n) ((n) == 4 ? 0.25f : (n) % 2 ? 0.125f : 0.0625f)

// Pixel i of a row or column lies between block NEAREST(i) and the next block, whose weight is NEXT_SHARE(i). NEAREST(i) is −1 before the
// middle of the first block.
#define NEAREST(i) (((i) + 2) / 4 - 1)
#define NEXT_SHARE(i) (((i) + 2) % 4 * 0.25f + 0.125f)
