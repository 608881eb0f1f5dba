// Mirrors samples outside a frame about its outermost samples.

// Returns the index `wanted`, clamped to 0 … length - 1. In PoCL 3.0, min and max are slow function calls.
INLINE int within_length(int wanted, int length) { return wanted < 0 ? 0 : wanted < length ? wanted : length - 1; }

// Returns the index `wanted`, mirrored into 0 … length - 1.
INLINE int mirrored(int wanted, int length) {
    const int mirror = wanted < 0 ? -wanted : wanted >= length ? 2 * (length - 1) - wanted : wanted;
    return within_length(mirror, length);
}

#if LANES > 1

// Reads LANES values of a row from column x, mirrored into 0 … columns - 1.
INLINE floats read_across(__global const float *row, int x, int columns) {
    if (x >= 0 && x + LANES <= columns) return LOAD_GLOBAL(floats, row + x);
    float value[LANES];
    AT_EDGE
    for (int i = 0; i < LANES; i++) value[i] = row[mirrored(x + i, columns)];
    return LOAD_PRIVATE(floats, value);
}

#endif
