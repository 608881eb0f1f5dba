// Processor variant: computes the classes of a refinement layer from the luminance plane and the classes of the first layer.
//
// Each work-item processes one tile of TILE columns and BAND rows, row by row. The structure tensors are separable: products of gradients in the
// latest five rows are summed over the rows and then over the columns, with weights.

#define WINDOW 5

typedef struct {
    int xx[REACHED], yy[REACHED], xy[REACHED];
} Products;

INLINE void multiply(Products *products, const int *above, const int *middle, const int *below, const Words *words, int span) {
    for (int p = 1; p < span; p += LANES) {
        const uints scale = gradient_words(words, p);
        const ints gx = gradient(LOAD_PRIVATE(ints, middle + p + 1) - LOAD_PRIVATE(ints, middle + p - 1), scale, GRADIENT_TOP);
        const ints gy = gradient(LOAD_PRIVATE(ints, below + p) - LOAD_PRIVATE(ints, above + p), scale, GRADIENT_TOP);
        STORE_PRIVATE(ints, products->xx + p) = gx * gx;
        STORE_PRIVATE(ints, products->yy + p) = gy * gy;
        STORE_PRIVATE(ints, products->xy + p) = gx * gy;
    }
}

// a + 2 b + 3 c + 2 d + e by additions, because 32-bit multiplications take twice as long.
INLINE ints weigh(ints a, ints b, ints c, ints d, ints e) {
    const ints middle = b + c + d;
    return (middle + middle) + ((a + e) + c);
}

// Weighted sums over five rows, starting with rows[first % WINDOW].
INLINE void weigh_rows(Products *sum, const Products *rows, int first, int span) {
    const Products *r[WINDOW];
    for (int i = 0; i < WINDOW; i++) r[i] = rows + (first + i) % WINDOW;
#define ROW(i, name, p) LOAD_PRIVATE(ints, r[i]->name + p)
#define DOWN(name, p) weigh(ROW(0, name, p), ROW(1, name, p), ROW(2, name, p), ROW(3, name, p), ROW(4, name, p))
    for (int p = 1; p < span; p += LANES) {
        STORE_PRIVATE(ints, sum->xx + p) = DOWN(xx, p);
        STORE_PRIVATE(ints, sum->yy + p) = DOWN(yy, p);
        STORE_PRIVATE(ints, sum->xy + p) = DOWN(xy, p);
    }
}

// Weighted sums over five columns, starting at `at`.
INLINE ints across(const int *at) {
    return weigh(LOAD_PRIVATE(ints, at), LOAD_PRIVATE(ints, at + 1), LOAD_PRIVATE(ints, at + 2), LOAD_PRIVATE(ints, at + 3),
                 LOAD_PRIVATE(ints, at + 4));
}

#ifndef TRANSFORM_ONLY  // another program contains this kernel if TRANSFORM_ONLY is set
COMPILED_ONCE structures_of_tile(int x0, int y0, STRUCTURES_PARAMETERS) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int span = width + 2 * STRUCTURE_REACH;
    __global const int *luminance_plane = planes + (size_t)LUMINANCE * source_rows * columns;
    int luminance[3][REACHED];
    Words words[4];
    Products ring[WINDOW], sum;
    for (int i = 0; i < 3; i++)
        for (int p = 0; p < REACHED; p++) luminance[i][p] = 0;
    for (int i = 0; i < 4; i++)
        for (int p = 0; p < REACHED; p++) words[i].of[p] = 0;
    for (int k = 0; k < y1 - y0 + 2 * STRUCTURE_REACH; k++) {
        read_plane(luminance[k % 3], luminance_plane + (size_t)row_source[y0 + k] * columns, column_source, x0, span, columns);
        read_words(words + k % 4, first_labels + (size_t)label_source[y0 + k] * columns, column_source, label_words, x0, span,
                   columns);
        if (k < 2) continue;
        multiply(ring + (k - 2) % WINDOW, luminance[(k - 2) % 3], luminance[(k - 1) % 3], luminance[k % 3], words + (k - 1) % 4,
                 span);
        if (k < 2 * STRUCTURE_REACH) continue;
        weigh_rows(&sum, ring, k - 6, span);
        const Words *middle = words + (k - STRUCTURE_REACH) % 4;
        __global uint *label_row = labels + (size_t)(y0 + k - 2 * STRUCTURE_REACH) * columns + x0;
        const int next = min(y0 + k + 1, y1 + 2 * STRUCTURE_REACH - 1);
        __global const int *next_luminance = luminance_plane + (size_t)row_source[next] * columns + x0;
        __global const uint *next_labels = first_labels + (size_t)label_source[next] * columns + x0;
        for (int x = 0; x < width; x += LANES) {
            FETCH(next_luminance + x);
            FETCH(next_labels + x);
            const uints xx = SAME_BITS(across(sum.xx + x + 1), uints), yy = SAME_BITS(across(sum.yy + x + 1), uints);
            const uints turns = gradient_words(middle, x + STRUCTURE_REACH), first = start_words(middle, x + STRUCTURE_REACH);
            const uints structure = structure_of(xx, yy, across(sum.xy + x + 1), turns, strength_edges);
            write_labels(label_row, DECIDED(first) != 0 ? FIRST_CLASS(first) : first + structure, x, width);
        }
    }
}

KERNEL_OF_ONE structures(STRUCTURES_PARAMETERS) { structures_of_tile(GROUP_COLUMN, GROUP_ROW, STRUCTURES_READ); }
#endif
