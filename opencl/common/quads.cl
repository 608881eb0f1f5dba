// Maps of quads, which are groups of 2 × 2 pixels (l3cli/classes/clipping.py). Map 0 is the replaced fraction of the outputs, and maps 1 to 3
// are the values added to X, Y and Z. Map 4 is the degree to which the hue changes, and maps 5 and 6 are X/Y and Z/Y of the new hue multiplied
// by map 4. Rows are longer than needed, so that vectors may read beyond the last quad.

#define QUADS(length) (((length) + 1) / 2)
#define QUADS_STRIDE(columns) (QUADS(columns) + 16)
#define QUADS_PLANE(rows, columns) ((size_t)QUADS(rows) * QUADS_STRIDE(columns))
