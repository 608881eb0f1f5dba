// Outputs → what is written, for as many pixels as `floats` holds (render/display.py is the float64 truth).
//
// The host chooses by macros: PLANES: the outputs as they are; else X, Y, Z by a matrix to three values a pixel, by the
// sRGB curve if CURVE is 1, to CODE: an integer up to TOP, or, with TOP 0, the bits of a half or of a float.

#if CURVE
// Library functions are calls and would end the vectors. So with y = x^(-1/4) by CURVE_STEPS of Newton's iteration, whose
// first guess is within 3 % because a float's bits are nearly its logarithm, the power part of the curve is a polynomial in
// z = x y^3 = x^(1/4), of CURVE_TERMS, the lowest first: few of both for 8 bits, more for the rest (layout.curve_macros).
INLINE floats srgb_curve(floats linear) {
    const float term[] = {CURVE_TERMS};
    const floats x = linear > 0.003f ? linear : (floats)0.003f, part = x * -0.25f;
    floats y = SAME_BITS(0x4f58cae5 - (SAME_BITS(x, ints) >> 2), floats);
    #pragma unroll
    for (int i = 0; i < CURVE_STEPS; i++) {
        const floats y2 = y * y;
        y *= part * (y2 * y2) + 1.25f;
    }
    const floats z = x * y * (y * y);
    floats power = term[CURVE_DEGREE];
    #pragma unroll
    for (int i = CURVE_DEGREE - 1; i >= 0; i--) power = power * z + term[i];
    return linear > 0.0031308f ? power : 12.92f * linear;
}
#endif

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
