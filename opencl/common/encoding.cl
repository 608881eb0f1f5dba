// Converts outputs to picture values. A call processes as many pixels as `floats` has lanes. The float64 reference is
// l3cli/rendering/display.py.
//
// Macros from the host select the result. With PLANES, outputs are written unchanged. Otherwise, X, Y and Z are converted to three integers per
// pixel, of type CODE and up to TOP, by a matrix, gamut mapping and the transfer curve of a colour space.

#ifdef FIXED_POINT

// Rounds and clamps a fixed-point sum to a plane value (l3cli/classes/planes.py).
INLINE ints plane_value(ints sum, ints fraction) {
    const ints top = PLANE_TOP, value = (sum + ((ints)1 << fraction >> 1)) >> fraction, below = value < top ? value : top;
    return below > -top ? below : -top;
}

// Reduces a plane value to 16 bits, the input of all layers except the first and the last.
INLINE ints coarse(ints plane) {
    const ints top = COARSE_TOP, value = (plane + (1 << COARSE >> 1)) >> COARSE, below = value < top ? value : top;
    return below > -top ? below : -top;
}

#endif
#ifdef TOP

// The following functions move out-of-gamut colours into the gamut, along lines of constant hue. The float64 reference is
// l3cli/physics/gamut.py.

// Product of a matrix row and a vector.
#define GAMUT_SUM(m, row, v) ((m)[3 * (row)] * (v)[0] + (m)[3 * (row) + 1] * (v)[1] + (m)[3 * (row) + 2] * (v)[2])

INLINE floats least_of(floats a, floats b) { return a < b ? a : b; }
INLINE floats most_of(floats a, floats b) { return a > b ? a : b; }

// Computes x^(1/3) for x ≥ LEAST_CONE with Newton's method for y = x^(-1/3). The bit pattern of a float, read as an integer, is nearly linear
// in the float's logarithm, so an initial guess from the bit pattern is accurate to 4 %.
INLINE floats cube_root(floats x) {
    floats y = SAME_BITS(CONVERT(CONVERT(SAME_BITS(x, ints), floats) * (-1.0f / 3.0f) + (float)0x54a2fa8c, ints), floats);
    #pragma unroll
    for (int i = 0; i < 3; i++) y *= 4.0f / 3.0f - x * (1.0f / 3.0f) * (y * y * y);
    return x * (y * y);
}

// Moves a colour towards the grey of the same lightness until no linear value is negative. The distance from the grey, relative to the distance
// of the given colour, is the smallest root of three cubic polynomials, one per linear value. Each root is approximated by one step of Halley's
// method, which starts at the distance t.
INLINE void less_chromatic(floats *linear) {
    const float cones[] = {GAMUT_CONES}, back[] = {GAMUT_LINEAR}, light[] = {GAMUT_LIGHTNESS};
    floats chroma[3], squares[3], cubes[3], ends[3], lowest = (floats)0.0f, least = (floats)1.0f;
    #pragma unroll
    for (int c = 0; c < 3; c++) chroma[c] = GAMUT_SUM(cones, c, linear);
    const floats least_cone = most_of(most_of(most_of(chroma[0], chroma[1]), chroma[2]) * CONE_SHARE, (floats)LEAST_CONE);
    #pragma unroll
    for (int c = 0; c < 3; c++) chroma[c] = cube_root(most_of(chroma[c], least_cone));
    const floats lightness = most_of(GAMUT_SUM(light, 0, chroma), (floats)LEAST_LIGHTNESS), over = 1.0f / lightness;
    #pragma unroll
    for (int c = 0; c < 3; c++) {
        chroma[c] = chroma[c] * over - 1.0f;
        squares[c] = chroma[c] * chroma[c];
        cubes[c] = squares[c] * chroma[c];
        ends[c] = linear[c] * (over * over * over);
        lowest = least_of(lowest, ends[c]);
    }
    const floats t = 1.0f / (1.0f - lowest);
    #pragma unroll
    for (int p = 0; p < 3; p++) {
        const floats first = 3.0f * GAMUT_SUM(back, p, chroma), second = 3.0f * GAMUT_SUM(back, p, squares);
        const floats third = GAMUT_SUM(back, p, cubes);
        const floats value = 1.0f + t * (first + t * (second + t * third));
        const floats slope = first + t * (2.0f * second + t * (3.0f * third)), bend = 2.0f * second + t * (6.0f * third);
        const floats square = slope * slope + (floats)GAMUT_TINY;
        const floats root = t - 2.0f * value * slope / most_of(2.0f * square - value * bend, square);
        least = ends[p] < 0.0f ? least_of(least, root) : least;
    }
    least = most_of(least, (floats)0.0f);
    #pragma unroll
    for (int c = 0; c < 3; c++) {
        const floats root = lightness + least * (chroma[c] * lightness);
        cubes[c] = root * root * root;
    }
    const floats lowest_value = least_of(least_of(linear[0], linear[1]), linear[2]);
    #pragma unroll
    for (int p = 0; p < 3; p++) linear[p] = lowest_value < 0.0f ? GAMUT_SUM(back, p, cubes) : linear[p];
}

#ifndef TONE_A
// Limits values to 1 by a mixture of darkening and clipping. The brighter the colour, the larger the share of clipping.
INLINE void darker(floats *linear) {
    const float luminance[] = {GAMUT_LUMINANCE};
    const floats most = most_of(most_of(linear[0], linear[1]), linear[2]), share = 1.0f / most;
    floats clipped = GAMUT_SUM(luminance, 0, linear);
    clipped = least_of(most_of(clipped, (floats)0.0f), (floats)1.0f);
    clipped *= clipped;
    clipped *= clipped;
    #pragma unroll
    for (int p = 0; p < 3; p++) {
        const floats scaled = linear[p] * share;
        linear[p] = most > 1.0f ? scaled + clipped * (least_of(linear[p], (floats)1.0f) - scaled) : linear[p];
    }
}
#endif

// Returns whether any lane has its sign bit set.
INLINE bool any_negative(floats value) {
#if LANES == 1
    return value < 0.0f;
#elif LANES == 8 && defined(__AVX__)
    return __builtin_ia32_movmskps256(value);
#elif LANES == 16 && defined(__AVX__)
    return __builtin_ia32_movmskps256(__builtin_shufflevector(value, value, 0, 1, 2, 3, 4, 5, 6, 7))
           | __builtin_ia32_movmskps256(__builtin_shufflevector(value, value, 8, 9, 10, 11, 12, 13, 14, 15));
#else
    const ints bits = SAME_BITS(value, ints);
    int signs = 0;
    #pragma unroll
    for (int i = 0; i < LANES; i++) signs |= bits[i];
    return signs < 0;
#endif
}

// Moves colours into the gamut. Colours inside it do not change. The caller skips this function unless a lane is outside, which is rare.
static __attribute__((noinline)) void brought_into_gamut(floats *linear) {
    if (any_negative(least_of(least_of(linear[0], linear[1]), linear[2]))) less_chromatic(linear);
#ifndef TONE_A
    darker(linear);
#endif
}

INLINE void into_gamut(floats *linear) {
    const floats least = least_of(least_of(linear[0], linear[1]), linear[2]);
#ifdef TONE_A
    const floats room = least;
#else
    const floats room = least_of(least, 1.0f - most_of(most_of(linear[0], linear[1]), linear[2]));
#endif
    if (any_negative(room)) brought_into_gamut(linear);
}

// Applies the tone curve, if any, to linear values.
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

// Encodes 8-bit values on processors that can look up 16 lanes in a table of 32 entries with one instruction. The curve times TOP consists of
// 32 parabolas in u = 2^-8 + CURVE_SHARE · linear value, four per octave (layout.curve_pieces). The upper bits of u (as a float) select the
// parabola. The lookup uses the lowest five of these bits.
#define PIECE_BITS 21
__constant float curve_pieces[] = {CURVE_PIECES};  // coefficients of the parabolas, (power of u, parabola)

INLINE floats term_of(int power, ints piece) {
    __constant const floats_unaligned *table = (__constant const floats_unaligned *)(curve_pieces + 32 * power);
    return __builtin_ia32_vpermi2varps512(table[0], piece, table[1]);
}

// Encodes linear values of one channel as integers.
INLINE uints encode(floats linear) {
    const floats start = 0x1p-8f, end = 0x1.fffffep-1f;
    floats u = toned(linear) * CURVE_SHARE + start;
    u = u > start ? u : start;
    u = u < end ? u : end;
    const ints piece = SAME_BITS(u, ints) >> PIECE_BITS;
    return SAME_BITS(CONVERT((term_of(2, piece) * u + term_of(1, piece)) * u + term_of(0, piece), ints), uints);
}

#else

// Library functions would prevent vectorisation. Instead, CURVE_STEPS steps of Newton's method compute y = x^(-1/4). The bit pattern of a float
// is nearly its logarithm, so the initial guess is accurate to 3 %. The power part of the curve is a polynomial in z = x y^3 = x^(1/4) with the
// coefficients CURVE_TERMS, lowest power first. 8-bit pictures use fewer steps and terms than 16-bit pictures (layout.curve_macros).
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

// Encodes linear values of one channel as integers.
INLINE uints encode(floats linear) {
    return SAME_BITS(CONVERT(curve(clip(toned(linear))) * (float)TOP + 0.5f, ints), uints);
}

#endif
#endif
