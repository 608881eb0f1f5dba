// Spectra that take the mean of their neighbourhood and keep their brightness (l3cli/rendering/reference.py is the truth).

// What a neighbour counts whose brightness differs so much; `inverse`: of the difference from which it counts nothing.
INLINE floats nearness(floats difference, floats inverse) {
    const floats share = difference * inverse, left = 1.0f - share * share;
    const floats positive = left > 0.0f ? left : (floats)0.0f;
    return positive * positive;
}

INLINE floats inverse_of(floats brightness, float reach) {
    const floats above = brightness > DARKEST ? brightness : (floats)DARKEST;
    return 1.0f / (reach * above);
}

// What the mean is multiplied by, of the pixel's brightness and the mean of the neighbours' above it.
INLINE floats brightness_ratio(floats brightness, floats brighter) {
    return brightness > DARKEST ? brightness / (brightness + brighter) : (floats)1.0f;
}

// Which of `length` samples stands where sample `wanted` is missing: the mirror image.
INLINE int mirrored(int wanted, int length) {
    const int mirror = wanted < 0 ? -wanted : wanted >= length ? 2 * (length - 1) - wanted : wanted;
    return min(max(mirror, 0), length - 1);
}
