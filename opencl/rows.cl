// Processor variant: a row of outputs → what is written of it.

#ifdef SHADED

#define LANE(i) (float)(i)

// planes[o * TILE + x] times the gain of its pixel, linear between the nodes of a row, GAIN_STEP columns apart.
INLINE void even_row(float *planes, __global const float *gain, int x0, int width) {
    const floats lane = (floats)(ALL_LANES(LANE));
    for (int x = 0; x < width; x += LANES) {
        const int node = (x0 + x) / GAIN_STEP;
        const floats part = ((float)((x0 + x) % GAIN_STEP) + lane) * (1.0f / GAIN_STEP);
        const floats factor = gain[node] + (gain[node + 1] - gain[node]) * part;
        for (int o = 0; o < OUTPUTS; o++)
            STORE_PRIVATE(floats, planes + o * TILE + x) = LOAD_PRIVATE(floats, planes + o * TILE + x) * factor;
    }
}

#endif

#if defined(FIXED_POINT)

// planes[o * TILE + x] → what the next layer reads (output, pixel), past the caches where vectors lie on whole lines: it is read
// when all is written, and no cache holds all.
INLINE void write_row(__global int *picture, const total *planes, __global const float *matrix, size_t at, int width,
                      size_t pixels) {
    for (int o = 0; o < OUTPUTS; o++) {
        __global int *to = picture + o * pixels + at;
        const bool whole_lines = (size_t)to % sizeof(ints) == 0;
        int x = 0;
        for (; whole_lines && x + LANES <= width; x += LANES)
            __builtin_nontemporal_store(LOAD_PRIVATE(ints, planes + o * TILE + x), (__global ints *)(to + x));
        for (; x < width; x++) to[x] = planes[o * TILE + x];
    }
}

#elif defined(PLANES)

// planes[o * TILE + x] → picture (output, pixel)
INLINE void write_row(__global float *picture, const float *planes, __global const float *matrix, size_t at, int width,
                      size_t pixels) {
    for (int o = 0; o < OUTPUTS; o++)
        for (int x = 0; x < width; x++) picture[o * pixels + at + x] = planes[o * TILE + x];
}

#elif defined(NOT_ENCODED)

// For timing: the sum of three planes.
INLINE void write_row(__global float *picture, const float *planes, __global const float *matrix, size_t at, int width,
                      size_t pixels) {
    for (int x = 0; x < width; x++) picture[at + x] = planes[x] + planes[TILE + x] + planes[2 * TILE + x];
}

#else

VECTOR(CODE, codes, LANES);
VECTOR(CODE, two_codes, 2 * LANES);
typedef uchar four_bytes __attribute__((ext_vector_type(4 * LANES)));

#define EIGHT(index, i) index(i), index(i + 1), index(i + 2), index(i + 3), index(i + 4), index(i + 5), index(i + 6), index(i + 7)
#if LANES == 16
#define FIRST_LANES(index, i) EIGHT(index, i), EIGHT(index, i + 8)
#define TWICE_LANES(index, i) FIRST_LANES(index, i), FIRST_LANES(index, i + 16)
#else
#define FIRST_LANES(index, i) EIGHT(index, i)
#define TWICE_LANES(index, i) EIGHT(index, i), EIGHT(index, i + 8)
#endif

// Values a, b, c of LANES pixels → pixel by pixel.
#if TOP == 255
// Bytes: those of a pixel in one word, then every fourth is left out.
#define PLACE(i) ((i) / 3 * 4 + (i) % 3)
INLINE void interleave(two_codes *low, codes *high, uints a, uints b, uints c) {
    const four_bytes words = SAME_BITS(a | b << 8 | c << 16, four_bytes);
    *low = __builtin_shufflevector(words, words, TWICE_LANES(PLACE, 0));
    *high = __builtin_shufflevector(words, words, FIRST_LANES(PLACE, 2 * LANES));
}
#else
#define PLACE(i) ((i) / 3 + (i) % 3 * LANES)
#define SAME(i) (i)
INLINE void interleave(two_codes *low, codes *high, uints a, uints b, uints c) {
    const two_codes ab = __builtin_shufflevector(CONVERT(a, codes), CONVERT(b, codes), TWICE_LANES(SAME, 0));
    const two_codes cc = __builtin_shufflevector(CONVERT(c, codes), CONVERT(c, codes), TWICE_LANES(SAME, 0));
    *low = __builtin_shufflevector(ab, cc, TWICE_LANES(PLACE, 0));
    *high = __builtin_shufflevector(ab, cc, FIRST_LANES(PLACE, 2 * LANES));
}
#endif

// planes[o * TILE + x] of X, Y, Z → picture (pixel, 3)
INLINE void write_row(__global CODE *picture, const float *planes, __global const float *matrix, size_t at, int width,
                      size_t pixels) {
    __global CODE *to = picture + 3 * at;
    for (int x = 0; x < width; x += LANES) {
        const floats X = LOAD_PRIVATE(floats, planes + x), Y = LOAD_PRIVATE(floats, planes + TILE + x);
        const floats Z = LOAD_PRIVATE(floats, planes + 2 * TILE + x);
        uints value[3];
        #pragma unroll
        for (int p = 0; p < 3; p++) value[p] = encode(matrix[3 * p] * X + matrix[3 * p + 1] * Y + matrix[3 * p + 2] * Z);
        two_codes low;
        codes high;
        interleave(&low, &high, value[0], value[1], value[2]);
        if (x + LANES <= width) {
            STORE_GLOBAL(two_codes, to + 3 * x) = low;
            STORE_GLOBAL(codes, to + 3 * x + 2 * LANES) = high;
        } else {
            CODE rest[3 * LANES];
            STORE_PRIVATE(two_codes, rest) = low;
            STORE_PRIVATE(codes, rest + 2 * LANES) = high;
            for (int i = 0; x + i / 3 < width; i++) to[3 * x + i] = rest[i];
        }
    }
}

#endif
