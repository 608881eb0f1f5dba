// Scale of the planes' gradients, for both variants (l3cli/classes/refinement.py).
//
// For each class of the first layer there are two words, the lower and the upper half of an element of label_words. The lower
// half, the gradient word, holds the factor of gradients, the shift (from bit 8) and the orientation of the site (from bit 14). The
// upper half, the start word, holds the first class of the site and level. If bit 31 is set, saturation decides and it is the
// class itself.

#define LABEL_CONSTANTS __global const ulong *restrict label_words  // (class)

// Parameters of the kernel `structures`, for all rules and variants: planes (plane, source row, col) of the previous layer; classes
// (source row, col) of the first layer; the row of either (padded row), and the column (padded col), that each padded one
// repeats; the constants of the rule; and the labels (row, col) to be written.
#define STRUCTURES_PARAMETERS \
    __global const int *restrict planes, __global const uint *restrict first_labels, __global const int *restrict row_source, \
    __global const int *restrict label_source, __global const int *restrict column_source, STRUCTURE_CONSTANTS, \
    __global uint *restrict labels, int source_rows, int rows, int columns
#define STRUCTURES_READ \
    planes, first_labels, row_source, label_source, column_source, STRUCTURE_READ, labels, source_rows, rows, columns

#define FACTOR_BITS 0x7f
#define SHIFT_BITS(word) ((word) >> 8 & 0x1f)
#define DECIDED(start) ((start) >> 31)
#define FIRST_CLASS(start) ((start) & 0x7fffffff)
#define STRUCTURE_REACH 3  // pixels on each side that decide a class

// A difference of a plane's pixels in units of its noise, clamped to ±top.
INLINE ints gradient(ints difference, uints scale, int top) {
    const ints scaled = (difference * SAME_BITS(scale & FACTOR_BITS, ints)) >> SAME_BITS(SHIFT_BITS(scale), ints);
    const ints most = top, below = scaled < most ? scaled : most;
    return below > -most ? below : -most;
}
