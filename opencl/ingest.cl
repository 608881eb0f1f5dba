// Processor variant: raw rows → rows of a tile.
//
// A tile is TILE columns wide; with the margins of its patches it reads SPAN columns, numbered p, the first of which lies
// RADIUS to the left of the tile. Padded rows and columns are those of the frame with RADIUS more on every side:
// row_source and column_source name the raw one that each repeats (frame.mirrored_indices), so that padding never breaks
// the phase of the CFA.

#define SPAN ((TILE + 2 * RADIUS + 4 * LANES - 1) / (2 * LANES) * (2 * LANES) + LANES)  // slack for reads past the last patch
#define WHOLE(n, size) (((n) + (size) - 1) / (size) * (size))  // n rounded up

// CFA phase n columns on. Arrays with a `period` axis repeat a row of the CFA until a vector can be read from any phase on;
// where the CFA divides the vector, the phase stays, and the compiler keeps their vectors in registers.
#if LANES % CFA_COLUMNS == 0
#define PHASE_AFTER(phase, n) (phase)
#else
#define PHASE_AFTER(phase, n) (((phase) + (n)) % CFA_COLUMNS)
#endif

// One raw row → row[p], at most MAX_RAW, for the tile that begins at column x0.
INLINE void ingest(ushort *row, __global const ushort *raw_row, __global const int *column_source, int x0, int columns) {
    const int first = max(0, RADIUS - x0), last = min(TILE + 2 * RADIUS, columns - x0 + RADIUS);
    const int end = min(TILE + 2 * RADIUS, columns - x0 + 2 * RADIUS);
    __global const ushort *inside = raw_row + x0 - RADIUS;
    int p = first;
    for (; p + 2 * LANES <= last; p += 2 * LANES) {
        const full_shorts v = LOAD_GLOBAL(full_shorts, inside + p), top = (ushort)MAX_RAW;
        STORE_PRIVATE(full_shorts, row + p) = v < top ? v : top;
    }
    for (; p < last; p++) row[p] = min(inside[p], (ushort)MAX_RAW);
    for (p = 0; p < first; p++) row[p] = min(raw_row[column_source[x0 + p]], (ushort)MAX_RAW);
    for (p = last; p < end; p++) row[p] = min(raw_row[column_source[x0 + p]], (ushort)MAX_RAW);
}
