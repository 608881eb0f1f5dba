// Class feature structure, for both variants (l3cli/classes/structure.py).

#define STRUCTURE_CONSTANTS LABEL_CONSTANTS, __global const uint *restrict strength_edges
#define STRUCTURE_READ label_words, strength_edges
#define TURN_A 14  // bit of the gradient word that changes the sign of a
#define TURN_B 15  // bit of the gradient word that changes the sign of b

INLINE uints size_of(ints value) { return SAME_BITS(value > 0 ? value : -value, uints); }

// Returns the structure of a pixel. xx, yy and xy are weighted sums of gradient products. The gradient word `turns` (gradient.cl) contains the
// orientation of the site.
INLINE uints structure_of(uints xx, uints yy, ints xy, uints turns, __global const uint *strength_edges) {
    const uints trace = xx + yy;
    uints strength = 0;
    #pragma unroll
    for (int k = 0; k < STRENGTHS; k++) strength = trace > strength_edges[k] ? strength + 1 : strength;
    const ints difference = SAME_BITS(xx - yy, ints) >> 6, product = xy >> 5;
    const ints a = (turns >> TURN_A & 1) != 0 ? -difference : difference, b = (turns >> TURN_B & 1) != 0 ? -product : product;
    const uints width = size_of(a), height = size_of(b), both = ((width + height) * 45) >> 6;
    const uints axis_a = a > 0 ? (uints)0 : (uints)4, axis_b = b > 0 ? (uints)2 : (uints)6;
    const uints below = b > 0 ? (uints)3 : (uints)5, above = b > 0 ? (uints)1 : (uints)7;
    const uints diagonal = a > 0 ? above : below;
    const uints flatter = 12 * width < 5 * height ? axis_b : diagonal, longer = 12 * width < 5 * height ? height : both;
    const uints direction = 12 * height < 5 * width ? axis_a : flatter, along = 12 * height < 5 * width ? width : longer;
    const uints within = along * 64 > (trace >> 6) * COHERENCE ? direction + 1 : (uints)0;
    return strength > 0 ? 1 + (strength - 1) * (1 + DIRECTIONS) + within : (uints)0;
}
