// Smooths chroma by averaging a pixel with similar neighbours, without changing the luminance. The reference is
// l3cli/rendering/reference.py. The eight neighbours are at (±1, ±1), (±CHROMA_REACH, 0) and (0, ±CHROMA_REACH).

// Weights of the squared differences between a pixel and a neighbour: in luminance, X and Z.
typedef struct {
    floats luminance, x, z;
} Factors;

INLINE Factors factors_of(floats luminance, float by_luminance, float by_x, float by_z) {
    const floats above = luminance > DARKEST ? luminance : (floats)DARKEST, inverse = 1.0f / (above * above);
    const floats fourth = inverse * inverse;
    return (Factors){by_luminance * inverse, by_x * fourth, by_z * fourth};
}

// Adds a neighbour to the sums. `own` and `there` are X, Y and Z of the pixel and of the neighbour. sums[0] and sums[2] are the changes of X
// and Z, and sums[1] is the divisor of the changes.
INLINE void add_neighbour(floats *sums, const floats *own, const floats *there, Factors by) {
    const floats brighter = there[1] - own[1];
    const floats x = there[0] * own[1] - own[0] * there[1], z = there[2] * own[1] - own[2] * there[1];
    const floats left = 1.0f - brighter * brighter * by.luminance - x * x * by.x - z * z * by.z;
    const floats positive = left > 0.0f ? left : (floats)0.0f, weight = positive * positive;
    sums[0] += weight * x;
    sums[1] += weight * there[1];
    sums[2] += weight * z;
}

// Applies the changes to `own`, the X, Y and Z of the pixel.
INLINE void change_chroma(floats *own, const floats *sums) {
    const floats divisor = own[1] > DARKEST ? own[1] + sums[1] : (floats)1.0f, share = 1.0f / divisor;
    own[0] = own[1] > DARKEST ? own[0] + sums[0] * share : own[0];
    own[2] = own[1] > DARKEST ? own[2] + sums[2] * share : own[2];
}
