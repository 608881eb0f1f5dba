// Mirrors samples outside a frame about its outermost samples.

// Returns the index `wanted`, mirrored into 0 … length - 1.
INLINE int mirrored(int wanted, int length) {
    const int mirror = wanted < 0 ? -wanted : wanted >= length ? 2 * (length - 1) - wanted : wanted;
    return min(max(mirror, 0), length - 1);
}

#if LANES > 1

// Reads LANES values of a row from column x, mirrored into 0 … columns - 1.
INLINE floats read_across(__global const float *row, int x, int columns) {
    if (x >= 0 && x + LANES <= columns) return LOAD_GLOBAL(floats, row + x);
    float value[LANES];
    for (int i = 0; i < LANES; i++) value[i] = row[mirrored(x + i, columns)];
    return LOAD_PRIVATE(floats, value);
}

#endif
