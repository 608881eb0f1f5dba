// Outputs → what is written, for as many pixels as `floats` holds (render/display.py is the float64 truth).
//
// The host chooses by macros: PLANES: the outputs as they are; else X, Y, Z by a matrix to three values a pixel, by the
// sRGB curve if CURVE is 1, to CODE: an integer up to TOP, or, with TOP 0, the bits of a half or of a float.

// Library functions are calls and would end the vectors: x^(5/12) is x · y^7 with y = x^(-1/12) by Newton's iteration,
// whose first guess is within 3 % because a float's bits are nearly its logarithm.
INLINE floats twelfth_root_reciprocal(floats x) {
    const floats bits = CONVERT(SAME_BITS(x, ints), floats), part = x * (1.0f / 12.0f);
    floats y = SAME_BITS(CONVERT(1.1537e9f - bits * (1.0f / 12.0f), ints), floats);
    #pragma unroll
    for (int i = 0; i < 3; i++) {
        const floats y2 = y * y, y4 = y2 * y2;
        y *= (13.0f / 12.0f) - part * (y4 * y4) * y4;
    }
    return y;
}

INLINE floats srgb_curve(floats linear) {
    const floats x = linear > 0.003f ? linear : (floats)0.003f;
    const floats y = twelfth_root_reciprocal(x), y2 = y * y;
    const floats power = x * (y2 * y2) * y2 * y;
    return linear > 0.0031308f ? 1.055f * power - 0.055f : 12.92f * linear;
}

INLINE floats clip(floats linear) {
    linear = linear > 0.0f ? linear : (floats)0.0f;
    return linear < 1.0f ? linear : (floats)1.0f;
}

// Bits of the nearest half, ties to even. Below 2^-14 halves are equally spaced: adding 0.5 lets the float unit round.
INLINE uints half_bits(floats value) {
    const uints bits = SAME_BITS(value, uints), sign = bits & 0x80000000u, size = bits ^ sign;
    const uints normal = (size - (112u << 23) + 0xfffu + (size >> 13 & 1u)) >> 13;
    const uints tiny = SAME_BITS(SAME_BITS(size, floats) + 0.5f, uints) - 0x3f000000u;
    const uints huge = size > 0x7f800000u ? (uints)0x7e00u : (uints)0x7c00u;
    const uints half_size = size >= 0x47800000u ? huge : size < 0x38800000u ? tiny : normal;
    return half_size | sign >> 16;
}

// One channel's values as the integers, or bits, that are written.
INLINE uints encode(floats linear) {
#if TOP || CURVE
    linear = clip(linear);
#endif
#if CURVE
    linear = srgb_curve(linear);
#endif
#if TOP
    return SAME_BITS(CONVERT(linear * (float)TOP + 0.5f, ints), uints);
#else
    return sizeof(CODE) == 2 ? half_bits(linear) : SAME_BITS(linear, uints);
#endif
}
