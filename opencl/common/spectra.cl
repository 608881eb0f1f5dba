// Smoothing of spectra over the neighbourhood, with the brightness of each pixel kept (l3cli/rendering/reference.py is the reference).

// Weight of a neighbour by its difference in brightness; `inverse` is the reciprocal of the difference at which the weight is zero.
INLINE floats nearness(floats difference, floats inverse) {
    const floats share = difference * inverse, left = 1.0f - share * share;
    const floats positive = left > 0.0f ? left : (floats)0.0f;
    return positive * positive;
}

INLINE floats inverse_of(floats brightness, float reach) {
    const floats above = brightness > DARKEST ? brightness : (floats)DARKEST;
    return 1.0f / (reach * above);
}

// Factor of the mean spectrum, from the pixel's brightness and the mean amount by which its neighbours are brighter.
INLINE floats brightness_ratio(floats brightness, floats brighter) {
    return brightness > DARKEST ? brightness / (brightness + brighter) : (floats)1.0f;
}

// The sample, of `length`, that replaces sample `wanted` if it is outside: its mirror image.
INLINE int mirrored(int wanted, int length) {
    const int mirror = wanted < 0 ? -wanted : wanted >= length ? 2 * (length - 1) - wanted : wanted;
    return min(max(mirror, 0), length - 1);
}
