// Scales gradients of planes by their noise, for both variants (l3cli/classes/refinement.py).
//
// There is one element of label_words per class of the first layer. It consists of two words. The lower half, the gradient word, contains the
// factor for gradients, the shift (from bit 8) and the orientation of the site (from bit 14). The upper half, the start word, contains the
// first class with the same site and level. If bit 31 of the start word is set, the pixel is near a saturated pixel, and the remaining bits
// contain its class.

#define LABEL_CONSTANTS __global const ulong *restrict label_words  // (class)

// Parameters of the kernel `structures`, for all rules and variants:
// planes         (plane, source row, col) planes of the previous layer
// first_labels   (source row, col) class map of the first layer
// row_source     (padded row) index into the rows of `planes`
// label_source   (padded row) index into the rows of `first_labels`
// column_source  (padded col) index into the columns
// STRUCTURE_CONSTANTS  constants of the class rule
// labels         (row, col) receives the class map
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
#define STRUCTURE_REACH 3  // number of pixels on each side that affect a class

// Converts the difference between two pixels in a plane to multiples of the noise, clamped to ±top.
INLINE ints gradient(ints difference, uints scale, int top) {
    const ints scaled = (difference * SAME_BITS(scale & FACTOR_BITS, ints)) >> SAME_BITS(SHIFT_BITS(scale), ints);
    const ints most = top, below = scaled < most ? scaled : most;
    return below > -most ? below : -most;
}
