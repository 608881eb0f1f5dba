// Coarse chroma (l3cli/classes/coarse_chroma.py): means of BIN × BIN pixels, with a margin about them that is FAR from all.

#define BINS(length) (((length) + BIN - 1) / BIN)
#define MEANS_STRIDE(columns) (BINS(columns) + 2 * MARGIN + 16)  // of a row of means, which vectors may read past
#define MEANS_PLANE(rows, columns) ((size_t)(BINS(rows) + 2 * MARGIN) * MEANS_STRIDE(columns))

// Of differences d from planes at luminance y.
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

// Pixel i of a row or column lies between means NEAREST(i) and the next, this near to it.
#define NEAREST(i) (((i) + BIN / 2) / BIN - 1)
#define NEXT_SHARE(i) ((((i) + BIN / 2) % BIN + 0.5f) / BIN)
