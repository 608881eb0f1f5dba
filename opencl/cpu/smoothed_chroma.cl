// Processor variant: smooths the chroma of a band, and encodes the result (common/smoothed_chroma.cl).
//
// Each work-item processes one tile of TILE columns and BAND rows. The rows that a pixel and its neighbours occupy are copied to a ring that fits into
// the first-level cache, with mirrored columns outside the frame. In the planes themselves, the rows of a frame with 2^n columns would evict one
// another from the cache.

#define SIDE 16                                         // copied columns on either side of a tile, a whole number of vectors
#define PITCH (TILE + 2 * SIDE)                         // values per row of the ring
#define RING_ROWS (2 * CHROMA_REACH + 1)                // rows in the ring
#define IN_RING(row) ((row) % RING_ROWS * (3 * PITCH))  // where a row begins; `row` must not be negative

// Copies the columns of a tile, from x0, of one row of X, Y and Z to the ring.
INLINE void row_to_ring(float *to, __global const float *row, size_t stride, int x0, int width, int columns) {
    for (int o = 0; o < 3; o++)
        for (int x = -SIDE; x < width + SIDE; x += LANES)
            STORE_PRIVATE(floats, to + o * PITCH + SIDE + x) = read_across(row + o * stride, x0 + x, columns);
}

// Reads X, Y and Z of LANES pixels.
INLINE void read_three(floats *value, const float *at) {
    #pragma unroll
    for (int o = 0; o < 3; o++) value[o] = LOAD_PRIVATE(floats, at + o * PITCH);
}

// Smooths LANES pixels. `place[n]` is where neighbour n of the tile's first column is in the ring, and x the column in the tile.
INLINE void smooth_pixels(floats *own, const float *const *place, int x, float by_luminance, float by_x, float by_z) {
    floats sums[3] = {0.0f, 0.0f, 0.0f}, there[3], differences = 0.0f;
    read_three(own, place[NEIGHBOURS] + x);
    #pragma unroll
    for (int n = 0; n < NEAR_NEIGHBOURS; n++) differences += difference_between(own[1], LOAD_PRIVATE(floats, place[n] + x + PITCH));
    const Scaled scaled = scaled_pixel(own, differences, by_luminance, by_x, by_z);
    #pragma unroll
    for (int n = 0; n < NEIGHBOURS; n++) {
        read_three(there, place[n] + x);
        add_neighbour(sums, scaled, there, UNLIKE(n));
    }
    change_chroma(own, scaled, sums, by_x, by_z);
}

#ifdef LEAST_REACH
#define LEAST_ROWS (2 * LEAST_REACH + 1)

// Converts the raw values of LANES pixels, from column x, to the luminances of white objects with the same raw values. Columns outside the frame
// repeat the outermost pixels.
INLINE floats levels_of(__global const ushort *raw, __global const float *scale, float black_level, int phase, int x, int columns) {
    if (x >= 0 && x + LANES <= columns) {
        const shorts value = LOAD_GLOBAL(shorts, raw + x), within = value < (ushort)MAX_RAW ? value : (shorts)(ushort)MAX_RAW;
        return (CONVERT(CONVERT(within, ints), floats) - black_level) * LOAD_GLOBAL(floats, scale + (x + phase) % CFA_COLUMNS);
    }
    float level[LANES];
    AT_EDGE
    for (int i = 0; i < LANES; i++) {
        const int column = within_length(x + i, columns), value = raw[column] < MAX_RAW ? raw[column] : MAX_RAW;
        level[i] = ((float)value - black_level) * scale[(column + phase) % CFA_COLUMNS];
    }
    return LOAD_PRIVATE(floats, level);
}

// Computes, for the pixels of a tile in one row, the lowest level within LEAST_REACH columns.
INLINE void lowest_of_row(float *to, __global const ushort *raw, __global const float *scale, float black_level, int phase, int x0,
                          int width, int columns) {
    float level[PITCH];
    for (int x = -LANES; x < width + LANES; x += LANES)
        STORE_PRIVATE(floats, level + SIDE + x) = levels_of(raw, scale, black_level, phase, x0 + x, columns);
    for (int x = 0; x < width; x += LANES) {
        floats lowest = LOAD_PRIVATE(floats, level + SIDE + x);
        #pragma unroll
        for (int j = -LEAST_REACH; j <= LEAST_REACH; j++) {
            const floats other = LOAD_PRIVATE(floats, level + SIDE + x + j);
            lowest = other < lowest ? other : lowest;
        }
        STORE_PRIVATE(floats, to + x) = lowest;
    }
}

// Raises pixels that are much darker than the raw values around them. `lowest` contains the lowest levels of LEAST_ROWS rows.
INLINE void raise_pixels(floats *own, const float *const *place, const float (*lowest)[TILE], floats gain, int x) {
    floats smallest = LOAD_PRIVATE(floats, lowest[0] + x), diagonal[3] = {0.0f, 0.0f, 0.0f}, there[3];
    #pragma unroll
    for (int i = 1; i < LEAST_ROWS; i++) {
        const floats other = LOAD_PRIVATE(floats, lowest[i] + x);
        smallest = other < smallest ? other : smallest;
    }
    const floats least = gain * least_luminance(smallest);
    if (!any_lane(own[1] < least)) return;
    for (int n = 0; n < 4; n++) {
        read_three(there, place[n] + x);
        for (int o = 0; o < 3; o++) diagonal[o] += there[o];
    }
    raise_luminance(own, diagonal, least);
}
#endif

COMPILED_ONCE smooth_chroma_tile(int x0, int y0,
                                 __global const float *restrict made,    // (output, row of `made`, col)
                                 __global const float *restrict matrix,  // (3, 3) from XYZ to linear picture values
                                 __global CODE *restrict picture         // (row, col, 3), or (output, row, col)
                                 GAIN_PARAMETER, LEAST_PARAMETERS
                                 float by_luminance, float by_x, float by_z,
                                 int made_rows, int top,                 // number of rows in `made`, and index of its first row in the frame
                                 int first, int frame_rows,              // index of the first row to write, and number of rows in the frame
                                 int rows, int columns) {
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const size_t stride = (size_t)made_rows * columns, pixels = (size_t)rows * columns;
    const int down[] = {CHROMA_ROWS, 0}, right[] = {CHROMA_COLUMNS, 0};
    float ring[RING_ROWS * 3 * PITCH] __attribute__((aligned(64)));
#ifdef LEAST_REACH
    float lowest[LEAST_ROWS][TILE];
#endif
    // The ring's row number k contains the row that is CHROMA_REACH rows above row y0 + k of the band.
    for (int k = 0; k < y1 - y0 + 2 * CHROMA_REACH; k++) {
        const int line = mirrored(first + y0 + k - CHROMA_REACH, frame_rows) - top, y = y0 + k - 2 * CHROMA_REACH;
        __global const float *from = made + (size_t)line * columns, *next = from + columns + x0;
        row_to_ring(ring + IN_RING(k), from, stride, x0, width, columns);
        if (y < y0) {
            for (int x = -SIDE; x < width + SIDE; x += LANES)
                for (int o = 0; o < 3; o++) FETCH(next + o * stride + x);
            continue;
        }
        const float *place[NEIGHBOURS + 1];  // of the neighbours, and last of the pixels
        #pragma unroll
        for (int n = 0; n <= NEIGHBOURS; n++) place[n] = ring + IN_RING(k - CHROMA_REACH + down[n]) + SIDE + right[n];
#ifdef LEAST_REACH
        for (int i = y == y0 ? -LEAST_REACH : LEAST_REACH; i <= LEAST_REACH; i++) {
            const int raw_line = within_length(first + y + i, frame_rows);
            lowest_of_row(lowest[(k + i) % LEAST_ROWS], raw + (size_t)(raw_line - raw_first) * columns,
                          scale + (raw_line + phase_row) % CFA_ROWS * SCALE_PERIOD, black_level, phase_column, x0, width, columns);
        }
        __global const ushort *next_raw =
            raw + (size_t)(within_length(first + y + LEAST_REACH + 1, frame_rows) - raw_first) * columns + x0;
#endif
        for (int x = 0; x < width; x += LANES) {
            floats own[3];
            for (int o = 0; o < 3; o++) FETCH(next + o * stride + x + SIDE);
            smooth_pixels(own, place, x, by_luminance, by_x, by_z);
#ifdef LEAST_REACH
#ifdef SHADED
            const floats factor = gains_at(gain + (size_t)(first + y - top) * GAIN_NODES(columns), x0 + x);
#else
            const floats factor = 1.0f;
#endif
            FETCH(next_raw + x + LANES);
            raise_pixels(own, place, lowest, factor, x);
#endif
            write_pixels(picture, own, matrix, (size_t)y * columns + x0 + x, width - x, pixels);
        }
    }
}

KERNEL_OF_ONE smooth_chroma(__global const float *restrict made, __global const float *restrict matrix, __global CODE *restrict picture
                            GAIN_PARAMETER, LEAST_PARAMETERS float by_luminance, float by_x, float by_z, int made_rows, int top, int first,
                            int frame_rows, int rows, int columns) {
    smooth_chroma_tile(GROUP_COLUMN, GROUP_ROW, made, matrix, picture GAIN_READ, LEAST_READ by_luminance, by_x, by_z, made_rows, top, first,
                       frame_rows, rows, columns);
}
