// Processor variant: writes the outputs of a row, LANES pixels at a time. The processor can then compute the sums of the next pixels while it
// applies the transfer curve and stores the results.

#ifdef SHADED
#define GAIN_PARAMETER , __global const float *restrict gain  // (row, grid node) shading gains of the outputs
#define GAIN_READ , gain

#define LANE(i) (float)(i)

// Shading gains of LANES pixels from column x. `gain` contains the gains of a row at grid nodes that are GAIN_STEP columns apart. Between the nodes,
// gains are interpolated linearly.
INLINE floats gains_at(__global const float *gain, int x) {
    const int node = x / GAIN_STEP;
    const floats part = ((float)(x % GAIN_STEP) + (floats)(ALL_LANES(LANE))) * (1.0f / GAIN_STEP);
    return gain[node] + (gain[node + 1] - gain[node]) * part;
}

INLINE void even_pixels(floats *made, __global const float *gain, int x) {
    const floats factor = gains_at(gain, x);
    for (int o = 0; o < OUTPUTS; o++) made[o] *= factor;
}

#else
#define GAIN_PARAMETER
#define GAIN_READ
#endif

#if defined(WHITE_FROM) && !defined(FIXED_POINT)
// Limits the luminance of XYZ in made[0] to made[2] to the luminance of the clipped white (l3cli/classes/clipping.py), which is stored after the
// matrix.
INLINE void limit_to_white(floats *made, __global const float *matrix) {
    const float limit = matrix[10];
    const floats luminance = made[1] > limit ? made[1] : (floats)limit, over = (luminance - limit) * (1.0f / (WHITE_FROM - 1.0f)) / limit;
    const floats faded = over < 1.0f ? over : (floats)1.0f, factor = limit / luminance * (1.0f - faded);
    #pragma unroll
    for (int o = 0; o < 3; o++) made[o] = factor * made[o] + faded * matrix[9 + o];
}
#else
#define limit_to_white(made, matrix)
#endif

// All versions of write_pixels write only the first `count` pixels, because the others are outside the frame.
#if defined(FIXED_POINT)

// Writes made[o] to planes (output, pixel) for the next layer. Aligned vectors bypass the caches, because planes do not fit into them and are
// read only after all planes are complete.
INLINE void write_pixels(__global int *picture, const ints *made, __global const float *matrix, size_t at, int count,
                         size_t pixels) {
    #pragma unroll
    for (int o = 0; o < OUTPUTS; o++) {
        __global int *to = picture + o * pixels + at;
        if (count >= LANES && (size_t)to % sizeof(ints) == 0) __builtin_nontemporal_store(made[o], (__global ints *)to);
        else if (count >= LANES) STORE_GLOBAL(ints, to) = made[o];
        else WRITE_FIRST(int, ints, to, made[o], count);
    }
}

#elif defined(PLANES)

// Writes made[o], output o of up to LANES pixels, as floats (output, pixel).
INLINE void write_pixels(__global float *picture, const floats *made, __global const float *matrix, size_t at, int count,
                         size_t pixels) {
    for (int o = 0; o < OUTPUTS; o++) {
        __global float *to = picture + o * pixels + at;
        if (count >= LANES) STORE_GLOBAL(floats, to) = made[o];
        else WRITE_FIRST(float, floats, to, made[o], count);
    }
}

#elif defined(NOT_ENCODED)

// Writes only the sum of three outputs, so that the time of the transforms can be measured without encoding.
INLINE void write_pixels(__global float *picture, const floats *made, __global const float *matrix, size_t at, int count,
                         size_t pixels) {
    const floats sum = made[0] + made[1] + made[2];
    for (int i = 0; i < min(count, LANES); i++) picture[at + i] = sum[i];
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

// Interleaves the values a, b and c of LANES pixels, so that each pixel's three values are consecutive.
#if TOP == 255
// A pixel's three bytes are packed in a 32-bit word. Then every fourth byte is removed.
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

// Encodes XYZ in made[0] to made[2], and writes the pixels to the picture (pixel, 3).
INLINE void write_pixels(__global CODE *picture, const floats *made, __global const float *matrix, size_t at, int count,
                         size_t pixels) {
    __global CODE *to = picture + 3 * at;
    floats linear[3];
    #pragma unroll
    for (int p = 0; p < 3; p++)
        linear[p] = matrix[3 * p] * made[0] + matrix[3 * p + 1] * made[1] + matrix[3 * p + 2] * made[2];
    into_gamut(linear);
    uints value[3];
    #pragma unroll
    for (int p = 0; p < 3; p++) value[p] = encode(linear[p]);
    two_codes low;
    codes high;
    interleave(&low, &high, value[0], value[1], value[2]);
    if (count >= LANES) {
        STORE_GLOBAL(two_codes, to) = low;
        STORE_GLOBAL(codes, to + 2 * LANES) = high;
    } else {
        CODE rest[3 * LANES];
        STORE_PRIVATE(two_codes, rest) = low;
        STORE_PRIVATE(codes, rest + 2 * LANES) = high;
        AT_EDGE
        for (int i = 0; i < 3 * count; i++) to[i] = rest[i];
    }
}

#endif
