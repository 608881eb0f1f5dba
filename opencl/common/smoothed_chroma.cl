// Smooths chroma by averaging a pixel with similar neighbours, without changing the luminance. Then raises the luminance of pixels that are
// much darker than the raw values around them. The reference is l3cli/rendering/reference.py. The macros CHROMA_ROWS and CHROMA_COLUMNS list
// the offsets of the NEIGHBOURS neighbours, of which the first NEAR_NEIGHBOURS are near. The first four are the diagonal neighbours.

// A pixel, scaled so that few operations are needed to compute the weight of a neighbour. The weight is zero if the sum of the squared scaled
// differences in luminance, X and Z is at least 1.
typedef struct {
    floats luminance, of_brighter, of_darker;              // luminance, and scales of its differences
    floats tolerance;                                      // luminance plus contrast, to which the differences are relative
    floats x, z, luminance_of_x, luminance_of_z;           // X, Z and luminance, times the scales of X and Z
} Scaled;

// `differences` is the sum of the absolute differences between the luminance of the pixel and of its near neighbours.
INLINE Scaled scaled_pixel(const floats *own, floats differences, float by_luminance, float by_x, float by_z) {
    const floats above = own[1] > DARKEST ? own[1] : (floats)DARKEST, most = MAX_CONTRAST * above;
    const floats contrast = differences * (1.0f / NEAR_NEIGHBOURS);
    const floats tolerance = above + (contrast < most ? contrast : most), inverse = 1.0f / tolerance;
    const floats of_brighter = by_luminance * inverse, of_black = 1.0f / above;
    const floats square = inverse * of_black, of_x = by_x * square, of_z = by_z * square;
    const floats of_darker = of_brighter > of_black ? of_brighter : of_black;
    return (Scaled){own[1], of_brighter, of_darker, tolerance, own[0] * of_x, own[2] * of_z, own[1] * of_x, own[1] * of_z};
}

INLINE floats difference_between(floats luminance, floats other) {
    const floats difference = luminance - other;
    return SAME_BITS(SAME_BITS(difference, ints) & 0x7fffffff, floats);
}

// Factor for the squared difference in chroma of neighbour `n`.
#define UNLIKE(n) ((n) < NEAR_NEIGHBOURS ? 1.0f : FAR_UNLIKE)

// Adds a neighbour with the XYZ `there` to the sums. sums[0] and sums[2] are the scaled changes in X and Z, and sums[1] is their divisor.
// `unlike` is the factor for the squared difference in chroma.
INLINE void add_neighbour(floats *sums, Scaled own, const floats *there, float unlike) {
    const floats brighter = (there[1] - own.luminance) * (there[1] > own.luminance ? own.of_brighter : own.of_darker);
    const floats x = there[0] * own.luminance_of_x - own.x * there[1], z = there[2] * own.luminance_of_z - own.z * there[1];
    const floats left = 1.0f - brighter * brighter - unlike * (x * x + z * z);
    const floats positive = left > 0.0f ? left : (floats)0.0f, weight = positive * positive;
    sums[0] += weight * x;
    sums[1] += weight * there[1];
    sums[2] += weight * z;
}

// Applies the changes to `own`, the pixel's XYZ. `by_x` and `by_z` are the arguments of `scaled_pixel`.
INLINE void change_chroma(floats *own, Scaled scaled, const floats *sums, float by_x, float by_z) {
    const floats bright = own[1] > DARKEST ? own[1] : (floats)0.0f, divisor = own[1] > DARKEST ? own[1] + sums[1] : (floats)1.0f;
    const floats share = bright * scaled.tolerance / divisor;
    own[0] += sums[0] * share * (1.0f / by_x);
    own[2] += sums[2] * share * (1.0f / by_z);
}

#ifdef LEAST_REACH
#define LEAST_PARAMETERS \
    __global const ushort *restrict raw,   /* (row, col) raw values in DN, with all rows that the band reads */ \
    __global const float *restrict scale,  /* (CFA row, SCALE_PERIOD) luminance of a white object per DN */ \
    float black_level, int raw_first,      /* `least_black_level` in DN, and index of the first raw row in the frame */ \
    int phase_row, int phase_column,       /* CFA site of the frame's first pixel */
#define LEAST_READ raw, scale, black_level, raw_first, phase_row, phase_column,

// Lower limit of a pixel's luminance, from the smallest raw value around it.
INLINE floats least_luminance(floats smallest) { return smallest * (smallest > 0.0f ? (floats)LEAST_OF_POSITIVE : (floats)LEAST_OF_NEGATIVE); }

INLINE floats within_change(floats change, floats most) {
    const floats below = change < most ? change : most;
    return below > -most ? below : -most;
}

// Raises the luminance of a pixel with the XYZ `own` to `least`. X and Z move towards the chroma of the diagonal neighbours, which have the
// XYZ sums `diagonal`.
INLINE void raise_luminance(floats *own, const floats *diagonal, floats least) {
    const floats raised = own[1] > least ? own[1] : least, most = RAISED_CHROMA * (raised - own[1]);
    const floats brighter = diagonal[1] > raised ? diagonal[1] : raised, divisor = brighter > DARKEST ? brighter : (floats)DARKEST;
    const floats share = raised / divisor;
    own[0] += within_change(share * diagonal[0] - own[0], most);
    own[1] = raised;
    own[2] += within_change(share * diagonal[2] - own[2], most);
}
#else
#define LEAST_PARAMETERS
#define LEAST_READ
#endif
