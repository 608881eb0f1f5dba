// Maps of quads, 2 × 2 pixels (l3cli/classes/clipping.py): the share of the outputs that is replaced, and what is added to each.
// Rows have room behind them that vectors may read.

#define QUADS(length) (((length) + 1) / 2)
#define QUADS_STRIDE(columns) (QUADS(columns) + 16)
#define QUADS_PLANE(rows, columns) ((size_t)QUADS(rows) * QUADS_STRIDE(columns))
