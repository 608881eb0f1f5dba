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

// A plane as a layer between reads it, in 16 bits.
INLINE ints coarse(ints plane) {
    const ints top = COARSE_TOP, value = (plane + (1 << COARSE >> 1)) >> COARSE, below = value < top ? value : top;
    return below > -top ? below : -top;
}

#endif
#ifdef TOP

// Linear values as a tone curve shows them.
INLINE floats toned(floats linear) {
#ifdef TONE_A
    linear = linear > 0.0f ? linear : (floats)0.0f;
    linear = linear < TONE_LIMIT ? linear : (floats)TONE_LIMIT;
    return linear * (TONE_A * linear + TONE_B) / (linear * (TONE_C * linear + TONE_D) + TONE_E);
#else
    return linear;
#endif
}

#if defined(CURVE_PIECES) && LANES == 16 && defined(__AVX512F__)

// Codes of 8 bits, where the processor looks up 16 lanes in a table of 32 at once: the curve times TOP in 32 parabolas, four an octave
// of u, which is the linear value and 2^-8 (layout.curve_pieces). A float's upper bits are the number of its parabola, of
// which the lookup reads the last five.
#define PIECE_BITS 21
__constant float curve_pieces[] = {CURVE_PIECES};  // (power of u, number of its parabola)

INLINE floats term_of(int power, ints piece) {
    __constant const floats_unaligned *table = (__constant const floats_unaligned *)(curve_pieces + 32 * power);
    return __builtin_ia32_vpermi2varps512(table[0], piece, table[1]);
}

// One channel's values as the codes that are written.
INLINE uints encode(floats linear) {
    const floats start = 0x1p-8f, end = 0x1.fffffep-1f;
    floats u = toned(linear) * CURVE_SHARE + start;
    u = u > start ? u : start;
    u = u < end ? u : end;
    const ints piece = SAME_BITS(u, ints) >> PIECE_BITS;
    return SAME_BITS(CONVERT((term_of(2, piece) * u + term_of(1, piece)) * u + term_of(0, piece), ints), uints);
}

#else

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
    return SAME_BITS(CONVERT(curve(clip(toned(linear))) * (float)TOP + 0.5f, ints), uints);
}

#endif
#endif
