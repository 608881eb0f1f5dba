// Processor variant: copies raw rows to the rows of a tile.
//
// A tile is TILE columns wide. Including the margins of the patches, SPAN columns are read, starting RADIUS columns to the left of the tile. Their
// number is p. The padded frame has RADIUS additional rows and columns on every side. row_source and column_source contain, for each padded row or
// column, the index of the raw row or column (frame.mirrored_indices). Padding preserves the CFA phase.

#define SPAN ((TILE + 2 * RADIUS + 4 * LANES - 1) / (2 * LANES) * (2 * LANES) + LANES)  // with space for reads beyond the last patch
#define WHOLE(n, size) (((n) + (size) - 1) / (size) * (size))  // n, rounded up to a multiple of `size`

// CFA phase after n columns. Arrays with a `period` axis repeat a CFA row, so that a vector can be read at any phase. If LANES is a multiple of
// the CFA width, the phase does not change, and the compiler keeps these vectors in registers.
#if LANES % CFA_COLUMNS == 0
#define PHASE_AFTER(phase, n) (phase)
#else
#define PHASE_AFTER(phase, n) (((phase) + (n)) % CFA_COLUMNS)
#endif

INLINE ushort highest_raw(ushort v) { return v < (ushort)MAX_RAW ? v : (ushort)MAX_RAW; }  // min is a function call in PoCL 3.0

INLINE void ingest_vector(ushort *row, __global const ushort *from) {
    const full_shorts v = LOAD_GLOBAL(full_shorts, from), top = (ushort)MAX_RAW;
    STORE_PRIVATE(full_shorts, row) = v < top ? v : top;
}

// Copies a raw row to row[p], clamped to MAX_RAW, for a tile that begins at column x0. The last vector inside the frame overlaps the previous
// vector, so that every pixel is copied by a whole vector.
INLINE void ingest(ushort *row, __global const ushort *raw_row, __global const int *column_source, int x0, int columns) {
    const int first = max(0, RADIUS - x0), last = min(TILE + 2 * RADIUS, columns - x0 + RADIUS);
    const int end = min(TILE + 2 * RADIUS, columns - x0 + 2 * RADIUS);
    __global const ushort *inside = raw_row + x0 - RADIUS;
    int p = first;
    for (; p + 2 * LANES <= last; p += 2 * LANES) ingest_vector(row + p, inside + p);
    if (last - first >= 2 * LANES) ingest_vector(row + last - 2 * LANES, inside + last - 2 * LANES);
    else AT_EDGE for (; p < last; p++) row[p] = highest_raw(inside[p]);
    AT_EDGE
    for (p = 0; p < first; p++) row[p] = highest_raw(raw_row[column_source[x0 + p]]);
    AT_EDGE
    for (p = last; p < end; p++) row[p] = highest_raw(raw_row[column_source[x0 + p]]);
}
