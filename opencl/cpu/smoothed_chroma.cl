// Processor variant: smooths the chroma of a band, and encodes the result (common/smoothed_chroma.cl).
//
// A work-item processes a tile of TILE columns and BAND rows.

// Reads LANES values of a row from column x. Unless `inside` is set, columns outside the frame are mirrored.
INLINE floats read_one(__global const float *row, int x, int columns, bool inside) {
    return inside ? LOAD_GLOBAL(floats, row + x) : read_across(row, x, columns);
}

// Reads X, Y and Z of LANES pixels.
INLINE void read_three(floats *value, __global const float *row, size_t stride, int x, int columns, bool inside) {
    #pragma unroll
    for (int o = 0; o < 3; o++) value[o] = read_one(row + o * stride, x, columns, inside);
}

INLINE void smooth_pixels(floats *own, __global const float *const *row, size_t stride, int x, int columns, bool inside,
                          float by_luminance, float by_x, float by_z) {
    floats sums[3] = {0.0f, 0.0f, 0.0f}, there[3], differences = 0.0f;
    const int right[] = {CHROMA_COLUMNS};
    read_three(own, row[NEIGHBOURS], stride, x, columns, inside);
    #pragma unroll
    for (int n = 0; n < NEAR_NEIGHBOURS; n++)
        differences += difference_between(own[1], read_one(row[n] + stride, x + right[n], columns, inside));
    const Scaled scaled = scaled_pixel(own, differences, by_luminance, by_x, by_z);
    #pragma unroll
    for (int n = 0; n < NEIGHBOURS; n++) {
        read_three(there, row[n], stride, x + right[n], columns, inside);
        add_neighbour(sums, scaled, there, UNLIKE(n));
    }
    change_chroma(own, scaled, sums, by_x, by_z);
}

#ifdef LEAST_REACH
#define MARGIN_COLUMNS (LEAST_REACH > CHROMA_REACH ? LEAST_REACH : CHROMA_REACH)

// Converts the raw values of LANES pixels, from column x, to the luminances of white objects with the same raw values. Columns outside the frame
// repeat the outermost pixels.
INLINE floats levels_of(__global const ushort *raw, __global const float *scale, float black_level, int phase, int x, int columns,
                        bool inside) {
    if (inside) {
        const shorts value = LOAD_GLOBAL(shorts, raw + x), within = value < (ushort)MAX_RAW ? value : (shorts)(ushort)MAX_RAW;
        return (CONVERT(CONVERT(within, ints), floats) - black_level) * LOAD_GLOBAL(floats, scale + (x + phase) % CFA_COLUMNS);
    }
    float level[LANES];
    AT_EDGE
    for (int i = 0; i < LANES; i++) {
        const int column = min(max(x + i, 0), columns - 1);
        level[i] = ((float)min(raw[column], (ushort)MAX_RAW) - black_level) * scale[(column + phase) % CFA_COLUMNS];
    }
    return LOAD_PRIVATE(floats, level);
}

// Raises pixels that are much darker than the raw values around them. The search for the smallest raw value ends as soon as all pixels of
// the vector are at least as bright as the values found so far require. For most pixels, this is at once.
INLINE void raise_pixels(floats *own, __global const float *const *row, size_t stride, LEAST_PARAMETERS floats gain, int y, int x,
                         int frame_rows, int columns, bool inside) {
    #define LEVELS(line, column) \
        levels_of(raw + (size_t)((line) - raw_first) * columns, scale + ((line) + phase_row) % CFA_ROWS * SCALE_PERIOD, black_level, \
                  phase_column, column, columns, inside)
    floats smallest = LEVELS(y, x);
    for (int i = -LEAST_REACH; i <= LEAST_REACH; i++) {
        if (!any_lane(own[1] < gain * least_luminance(smallest))) return;
        const int line = min(max(y + i, 0), frame_rows - 1);
        for (int j = -LEAST_REACH; j <= LEAST_REACH; j++) {
            const floats level = LEVELS(line, x + j);
            smallest = level < smallest ? level : smallest;
        }
    }
    floats diagonal[3] = {0.0f, 0.0f, 0.0f}, there[3];
    for (int n = 0; n < 4; n++) {
        const int right[] = {CHROMA_COLUMNS};
        read_three(there, row[n], stride, x + right[n], columns, inside);
        for (int o = 0; o < 3; o++) diagonal[o] += there[o];
    }
    raise_luminance(own, diagonal, gain * least_luminance(smallest));
}
#else
#define MARGIN_COLUMNS CHROMA_REACH
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
    for (int y = y0; y < y1; y++) {
        __global const float *row[NEIGHBOURS + 1];  // the rows of the neighbours, and last the row of the pixels
        const int down[] = {CHROMA_ROWS, 0};
        #pragma unroll
        for (int n = 0; n <= NEIGHBOURS; n++) row[n] = made + (size_t)(mirrored(first + y + down[n], frame_rows) - top) * columns;
        for (int x = 0; x < width; x += LANES) {
            floats own[3];
            const int column = x0 + x;
            const bool inside = column >= MARGIN_COLUMNS && column + LANES + MARGIN_COLUMNS <= columns;
            if (inside) smooth_pixels(own, row, stride, column, columns, true, by_luminance, by_x, by_z);
            else smooth_pixels(own, row, stride, column, columns, false, by_luminance, by_x, by_z);
#ifdef LEAST_REACH
#ifdef SHADED
            const floats factor = gains_at(gain + (size_t)(first + y - top) * GAIN_NODES(columns), column);
#else
            const floats factor = 1.0f;
#endif
            raise_pixels(own, row, stride, LEAST_READ factor, first + y, column, frame_rows, columns, inside);
#endif
            write_pixels(picture, own, matrix, (size_t)y * columns + column, width - x, pixels);
        }
    }
}

KERNEL_OF_ONE smooth_chroma(__global const float *restrict made, __global const float *restrict matrix, __global CODE *restrict picture
                            GAIN_PARAMETER, LEAST_PARAMETERS float by_luminance, float by_x, float by_z, int made_rows, int top, int first,
                            int frame_rows, int rows, int columns) {
    smooth_chroma_tile(GROUP_COLUMN, GROUP_ROW, made, matrix, picture GAIN_READ, LEAST_READ by_luminance, by_x, by_z, made_rows, top, first,
                       frame_rows, rows, columns);
}
