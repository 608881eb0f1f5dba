// Outputs → what is written, for as many pixels as `floats` holds (render/display.py is the float64 truth).
//
// The host chooses by macros: PLANES: the outputs as they are; else X, Y, Z by a matrix and the curve of a colour space to
// three values a pixel, each a CODE up to TOP.

#ifdef FIXED_POINT

// A fixed-point sum as a plane keeps it (l3cli/classes/planes.py).
INLINE ints plane_value(ints sum, ints fraction) {
    const ints top = PLANE_TOP, value = (sum + ((ints)1 << fraction >> 1)) >> fraction, below = value < top ? value : top;
    return below > -top ? below : -top;
}

// … and as a layer between reads it, in 16 bits.
INLINE ints coarse(ints plane) {
    const ints top = COARSE_TOP, value = (plane + (1 << COARSE >> 1)) >> COARSE, below = value < top ? value : top;
    return below > -top ? below : -top;
}

#endif
#ifdef TOP

// Library functions are calls and would end the vectors. So with y = x^(-1/4) by CURVE_STEPS of Newton's iteration, whose
// first guess is within 3 % because a float's bits are nearly its logarithm, the power part of the curve is a polynomial in
// z = x y^3 = x^(1/4), of CURVE_TERMS, the lowest first: few of both for 8 bits, more for the rest (layout.curve_macros).
INLINE floats curve(floats linear) {
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
    return linear > CURVE_KNEE ? power : CURVE_SLOPE * linear;
}

INLINE floats clip(floats linear) {
    linear = linear > 0.0f ? linear : (floats)0.0f;
    return linear < 1.0f ? linear : (floats)1.0f;
}

// One channel's values as the codes that are written.
INLINE uints encode(floats linear) {
    return SAME_BITS(CONVERT(curve(clip(linear)) * (float)TOP + 0.5f, ints), uints);
}

#endif
