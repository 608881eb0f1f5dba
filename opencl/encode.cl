// XYZ → sRGB as it is written to files: matrix, clip, curve, rounding (render/display.py is the float64 truth).
//
// One work-item encodes `strip` pixels, a multiple of 16; the buffers have room for a last vector that is not full.
// Library functions are calls and would end the vectors: x^(5/12) is x · y^7 with y = x^(-1/12) by Newton's iteration,
// whose first guess is within 3 % because a float's bits are nearly its logarithm.

INLINE float16 twelfth_root_reciprocal(float16 x) {
    const float16 bits = __builtin_convertvector(as_int16(x), float16);
    float16 y = as_float16(__builtin_convertvector(1.1537e9f - bits * (1.0f / 12.0f), int16));
    #pragma unroll
    for (int i = 0; i < 3; i++) {
        const float16 y2 = y * y, y4 = y2 * y2;
        y *= (13.0f / 12.0f) - x * (1.0f / 12.0f) * (y4 * y4) * y4;
    }
    return y;
}

INLINE float16 srgb_curve(float16 linear) {
    linear = linear > 0.0f ? linear : (float16)0.0f;
    linear = linear < 1.0f ? linear : (float16)1.0f;
    const float16 x = linear > 0.003f ? linear : (float16)0.003f;
    const float16 y = twelfth_root_reciprocal(x), y2 = y * y;
    const float16 power = x * (y2 * y2) * y2 * y;
    return linear > 0.0031308f ? 1.055f * power - 0.055f : 12.92f * linear;
}

// Three vectors of 16 values → 48 values, pixel by pixel, in two parts.
#define JOIN(a, b) __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, \
    16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31)
#define FIRST_32(rg, bb) __builtin_shufflevector(rg, bb, 0, 16, 32, 1, 17, 33, 2, 18, 34, 3, 19, 35, 4, 20, 36, 5, \
    21, 37, 6, 22, 38, 7, 23, 39, 8, 24, 40, 9, 25, 41, 10, 26)
#define LAST_16(rg, bb) __builtin_shufflevector(rg, bb, 42, 11, 27, 43, 12, 28, 44, 13, 29, 45, 14, 30, 46, 15, 31, 47)

#define ENCODE(NAME, TYPE, TOP)                                                                                         \
    typedef TYPE TYPE##16_packed __attribute__((ext_vector_type(16), aligned(sizeof(TYPE))));                           \
    typedef TYPE TYPE##32_packed __attribute__((ext_vector_type(32), aligned(sizeof(TYPE))));                           \
    __kernel void NAME(__global const float *restrict planes, /* (3, pixel) */                                          \
                       __global const float *restrict matrix, /* (3, 3) linear sRGB from XYZ */                         \
                       __global TYPE *restrict picture,       /* (pixel, 3) */                                          \
                       ulong pixels, int strip) {                                                                       \
        const ulong first = get_global_id(0) * (ulong)strip, last = min(first + strip, pixels);                         \
        for (ulong i = first; i < last; i += 16) {                                                                      \
            const float16 x = *(__global const float16_unaligned *)(planes + i);                                        \
            const float16 y = *(__global const float16_unaligned *)(planes + pixels + i);                               \
            const float16 z = *(__global const float16_unaligned *)(planes + 2 * pixels + i);                           \
            TYPE##16_packed value[3];                                                                                   \
            for (int p = 0; p < 3; p++) {                                                                               \
                const float16 linear = matrix[3 * p] * x + matrix[3 * p + 1] * y + matrix[3 * p + 2] * z;               \
                value[p] = __builtin_convertvector(srgb_curve(linear) * (float)TOP + 0.5f, TYPE##16_packed);            \
            }                                                                                                           \
            const TYPE##32_packed rg = JOIN(value[0], value[1]), bb = JOIN(value[2], value[2]);                         \
            *(__global TYPE##32_packed *)(picture + 3 * i) = FIRST_32(rg, bb);                                          \
            *(__global TYPE##16_packed *)(picture + 3 * i + 32) = LAST_16(rg, bb);                                      \
        }                                                                                                               \
    }

ENCODE(encode8, uchar, 255)
ENCODE(encode16, ushort, 65535)
