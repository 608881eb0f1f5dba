// Coarse chroma (l3cli/classes/coarse_chroma.py). A block is the mean of 4 × 4 pixels in each of three planes. The blocks are surrounded by a
// MARGIN of values that are not similar to any block. Rows are padded, so that vectors may read beyond the last block.

#define BLOCKS(length) (((length) + 3) / 4)
#define BLOCKS_STRIDE(columns) (BLOCKS(columns) + 2 * MARGIN + 16)
#define BLOCKS_PLANE(rows, columns) ((size_t)(BLOCKS(rows) + 2 * MARGIN) * BLOCKS_STRIDE(columns))

// Computes, for each plane, the reciprocal of the squared difference at which the likeness of two blocks with the luminance y reaches zero.
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

// Weight of block n among 3 × 3 blocks. The block in the centre has the number 4.
#define STEP_WEIGHT(n) ((n) == 4 ? 0.25f : (n) % 2 ? 0.125f : 0.0625f)

// For interpolation, pixel i in a row or column is between the centres of block NEAREST(i) and the next block. The weight of the next block is
// NEXT_SHARE(i). Before the centre of the first block, NEAREST(i) is −1.
#define NEAREST(i) (((i) + 2) / 4 - 1)
#define NEXT_SHARE(i) (((i) + 2) % 4 * 0.25f + 0.125f)
