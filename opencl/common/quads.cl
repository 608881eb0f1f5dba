// Maps for clipped areas, with one value per quad of 2 × 2 pixels (l3cli/classes/clipping.py). Map 0 is the fraction of the outputs to replace.
// Maps 1 to 3 are the replacements for X, Y and Z, times map 0. Map 4 is the degree of the hue change. Maps 5 and 6 are X/Y and Z/Y of the new
// hue, times map 4.
//
// The maps of each group of LANES quads in a row are consecutive, so that few cache lines are read and written: (quad row, group, map, quad).
// Vectors may read beyond the last quad. In the processor variant, a flag for each group follows the maps. The maps of a group are stored only
// if its flag is set. Otherwise, all of them are zero.

#define QUADS(length) (((length) + 1) / 2)
#define QUAD_GROUPS(columns) (QUADS(columns) / LANES + 1)
#define QUAD_GROUP(quad_row, quad, columns) ((size_t)(quad_row) * QUAD_GROUPS(columns) + (quad) / LANES)
#define QUAD_MAPS(maps, quad_row, quad, columns) ((maps) + QUAD_GROUP(quad_row, quad, columns) * (MAPS * LANES) + (quad) % LANES)
#define OF_MAP(m) ((m) * LANES)  // offset of map m from map 0 of the same quad
#define QUAD_FLAGS(maps, rows, columns) ((__global uchar *)((maps) + (size_t)QUADS(rows) * QUAD_GROUPS(columns) * (MAPS * LANES)))
