// Gradients of planes: their scale, and the words by which the classes of the layer before name it (l3cli/classes/refinement.py), for
// both variants.
//
// What a class of the first layer says of its pixels stands in two words, the lower and the upper one of label_words: its gradient
// word holds the factor of gradients, from bit 8 on their shift and from bit 14 on how the site is turned that it is learned as; its
// start word the first class of its site and level, and in bit 31 whether that is the class itself, saturation deciding.

#define LABEL_CONSTANTS __global const ulong *restrict label_words  // (class)

// Parameters of the kernel `structures`, of whatever rule and variant: planes (plane, source row, col) of the layer before; classes
// (source row, col) of the first layer; which rows (padded row) of the one and of the other, and which columns (padded col), each
// padded one repeats; the constants of the rule; and labels (row, col) to be written.
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
#define STRUCTURE_REACH 3  // pixels on each side that a class reads

// A difference of a plane's pixels in units of what noise makes of it, within ±top.
INLINE ints gradient(ints difference, uints scale, int top) {
    const ints scaled = (difference * SAME_BITS(scale & FACTOR_BITS, ints)) >> SAME_BITS(SHIFT_BITS(scale), ints);
    const ints most = top, below = scaled < most ? scaled : most;
    return below > -most ? below : -most;
}
