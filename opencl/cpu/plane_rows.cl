// Processor variant: reads padded rows of planes for a tile, and the element of label_words for each pixel's class in the first layer.

#define REACHED (TILE + 2 * STRUCTURE_REACH + 4 * LANES)

typedef struct {
    ulong of[REACHED];  // each pixel's element of label_words
} Words;

// Reads `end` padded columns from a row of a plane or class map, beginning STRUCTURE_REACH columns to the left of the tile.
INLINE void read_plane(int *to, __global const int *row, __global const int *column_source, int x0, int end, int columns) {
    const int first = max(0, STRUCTURE_REACH - x0), last = min(end, columns - x0 + STRUCTURE_REACH);
    int p = first;
    __global const int *inside = row + x0 - STRUCTURE_REACH;
    for (; p + LANES <= last; p += LANES) STORE_PRIVATE(ints, to + p) = LOAD_GLOBAL(ints, inside + p);
    if (last - first >= LANES) {  // the last vector overlaps the previous one
        p = last;
        STORE_PRIVATE(ints, to + p - LANES) = LOAD_GLOBAL(ints, inside + p - LANES);
    }
    AT_EDGE
    for (int i = 0; i < first; i++) to[i] = row[column_source[x0 + i]];
    AT_EDGE
    for (; p < end; p++) to[p] = row[column_source[x0 + p]];
}

INLINE void read_words(Words *to, __global const uint *labels, __global const int *column_source,
                       __global const ulong *label_words, int x0, int end, int columns) {
    int label[REACHED];
    read_plane(label, (__global const int *)labels, column_source, x0, end, columns);
    #pragma clang loop vectorize(disable) unroll_count(8)
    for (int p = 0; p < end; p++) to->of[p] = label_words[label[p]];
}

// Lower halves (gradient words) and upper halves (start words) of the label_words of LANES pixels from p (common/gradient.cl).
VECTOR(uint, words, 2 * LANES);
#define WORDS_AT(row, p) (*(const words_unaligned *)((row)->of + (p)))
#define HALVES_AT(row, p, which) __builtin_shufflevector(WORDS_AT(row, p), WORDS_AT(row, p), ALL_LANES(which))
INLINE uints gradient_words(const Words *row, int p) { return HALVES_AT(row, p, EVEN); }
INLINE uints start_words(const Words *row, int p) { return HALVES_AT(row, p, ODD); }

// Writes the classes of LANES pixels from x, in a row of `width` pixels.
INLINE void write_labels(__global uint *row, uints label, int x, int width) {
    if (x + LANES <= width) STORE_GLOBAL(uints, row + x) = label;
    else WRITE_FIRST(uint, uints, row + x, label, width - x);
}
