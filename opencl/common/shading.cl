// Corrects colour shading (the difference in shading between channels) in raw values. The reference is l3cli/frames/shading.py.
//
// The raw values are corrected in place, before any other kernel reads them. Each work-item corrects RUN pixels. The arithmetic uses integers,
// so that all devices have the same results. `colour` is the gain of the signal above black, minus 1. Clipped pixels do not change, and no
// other pixel becomes clipped.

INLINE ints corrected(ints value, ints colour, int black, int clipped) {
    const ints gained = value + (((value - black) * colour + (1 << FRACTION >> 1)) >> FRACTION), zero = 0, top = clipped - 1;
    const ints positive = gained > zero ? gained : zero, unclipped = positive < top ? positive : top;
    return value > top ? value : unclipped;
}

__kernel void correct_colour_shading(__global ushort *restrict raw, __global const short *restrict colour, int black, int clipped,
                            int pixels) {
    const int first = get_global_id(0) * RUN, last = min(first + RUN, pixels);
    int i = first;
#if LANES > 1
    for (; i + LANES <= last; i += LANES) {
        const ints value = CONVERT(LOAD_GLOBAL(shorts, raw + i), ints);
        STORE_GLOBAL(shorts, raw + i) =
            CONVERT(corrected(value, CONVERT(LOAD_GLOBAL(signed_shorts, colour + i), ints), black, clipped), shorts);
    }
#endif
    for (; i < last; i++) {
        const int value = raw[i], gained = value + (((value - black) * colour[i] + (1 << FRACTION >> 1)) >> FRACTION);
        raw[i] = value < clipped ? min(max(gained, 0), clipped - 1) : value;
    }
}
