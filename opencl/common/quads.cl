// Maps of quads, which are groups of 2 × 2 pixels (l3cli/classes/clipping.py): the fraction of the outputs that is replaced, and the
// replacement of each output, then the degree to which a pixel takes another hue, and X/Y and Z/Y of this hue multiplied by this degree.
// Rows are longer than needed, so that vectors may read beyond the last quad.

#define QUADS(length) (((length) + 1) / 2)
#define QUADS_STRIDE(columns) (QUADS(columns) + 16)
#define QUADS_PLANE(rows, columns) ((size_t)QUADS(rows) * QUADS_STRIDE(columns))
