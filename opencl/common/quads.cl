// Maps for clipped areas, with one value per quad of 2 × 2 pixels (l3cli/classes/clipping.py). Map 0 is the fraction of the outputs to replace.
// Maps 1 to 3 are the replacements for X, Y and Z, times map 0. Map 4 is the degree of the hue change. Maps 5 and 6 are X/Y and Z/Y of the new
// hue, times map 4. Rows are padded, so that vectors may read beyond the last quad.
//
// In the processor variant, a flag for each group of LANES quads follows the MAPS maps. The maps of a group are stored only if its flag is set.
// Otherwise, all of them are zero.

#define QUADS(length) (((length) + 1) / 2)
#define QUADS_STRIDE(columns) (QUADS(columns) + 16)
#define QUADS_PLANE(rows, columns) ((size_t)QUADS(rows) * QUADS_STRIDE(columns))
#define QUAD_FLAGS(maps, rows, columns) ((__global uchar *)((maps) + MAPS * QUADS_PLANE(rows, columns)))
#define QUAD_FLAG(quad_row, quad, columns) ((size_t)(quad_row) * (QUADS_STRIDE(columns) / LANES + 1) + (quad) / LANES)
