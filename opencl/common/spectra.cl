// Smooths spectra without changing the brightness of pixels. The reference is l3cli/rendering/reference.py.

// Weight of a neighbour by its difference in brightness. `inverse` is the reciprocal of the difference at which the weight reaches zero.
INLINE floats nearness(floats difference, floats inverse) {
    const floats share = difference * inverse, left = 1.0f - share * share;
    const floats positive = left > 0.0f ? left : (floats)0.0f;
    return positive * positive;
}

INLINE floats inverse_of(floats brightness, float reach) {
    const floats above = brightness > DARKEST ? brightness : (floats)DARKEST;
    return 1.0f / (reach * above);
}

// Factor by which the mean spectrum is multiplied to restore the pixel's brightness. `brighter` is the mean difference in brightness between
// the neighbours and the pixel.
INLINE floats brightness_ratio(floats brightness, floats brighter) {
    return brightness > DARKEST ? brightness / (brightness + brighter) : (floats)1.0f;
}
