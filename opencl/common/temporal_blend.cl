// Temporal filter: evidence of motion, weights of cells, and blending with the history (l3cli/rendering/temporal/reference.py).

// Arrays of cells are padded with zeros: PADDING columns on each side, and one row above and below.
INLINE int cell_row_length(int columns) { return columns + 2 * PADDING; }

INLINE int cell_place(int row, int column, int cell_columns) {
    return (row + 1) * cell_row_length(cell_columns) + PADDING + column;
}

// Returns by how many cells the centre of a cell moves if it is displaced by `vector` pixels.
INLINE int2 cells_on(int2 vector) {
    const int2 side = (int2)(CELL_ROWS, CELL_COLUMNS), far = 4096;  // cells; larger than any displacement, so that the dividend is positive
    return (side / 2 + vector + far * side) / side - far;
}

// Computes, for each cell in STRIP blocks, the sum of squared residuals, the sum of residuals, the variance of noise alone, and the noise
// fraction of the history at the previous position of the cell's centre. Residuals are differences between the frame and the history.
__kernel void evidence(__global const ushort *restrict raw, __global const ushort *restrict history,
                       __global const int2 *restrict vectors, __global const ushort *restrict left,
                       __global uint *restrict powers, __global int *restrict sums, __global uint *restrict variances,
                       __global ushort *restrict left_before, int free_bits, int black, int linear, int constant_term,
                       int fixed, int uneven, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, cell_columns = block_columns * CELL_ACROSS;
    const int count = (last - begin) * CELL_ACROSS;
    const wholes most = MOST_VARIANCE;
    for (int down = 0; down < CELL_DOWN; down++) {
        const int cell_row = block_row * CELL_DOWN + down;
        int square_of[STRIP_COLUMNS], sum_of[STRIP_COLUMNS], light_of[STRIP_COLUMNS];  // square_of must be read as uint
        int lefts[STRIP_CELLS], moved[STRIP_CELLS];
        for (int block = begin; block < last; block++) {
            const int2 vector = vectors[block_row * block_columns + block] * (int2)(PERIOD_ROWS, PERIOD_COLUMNS);
            const int2 on = cells_on(vector);
            __global const ushort *now = raw + cell_row * CELL_ROWS * columns + block * BLOCK_COLUMNS;
            __global const ushort *before = history + (cell_row * CELL_ROWS + vector.x) * columns + block * BLOCK_COLUMNS + vector.y;
            const int start = (block - begin) * BLOCK_COLUMNS, first = (block - begin) * CELL_ACROSS;
            for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                ints square = 0, sum = 0, light = 0;
                for (int y = 0; y < CELL_ROWS; y++) {
                    const ints value = units(READ(now + y * columns + x), free_bits);
                    const ints residual = least_of(most_of(value - READ(before + y * columns + x), -CLIPPED), CLIPPED);
                    FETCH_NEXT(now + (CELL_ROWS + y) * columns + x);
                    FETCH_NEXT(before + (CELL_ROWS + y) * columns + x);
                    square += residual * residual;
                    sum += residual;
                    light += value;
                }
                WRITE_PRIVATE(square_of + start + x, square);
                WRITE_PRIVATE(sum_of + start + x, sum);
                WRITE_PRIVATE(light_of + start + x, light);
            }
            const int there = cell_place(cell_row + on.x, block * CELL_ACROSS + on.y, cell_columns);
            for (int across = 0; across < CELL_ACROSS; across++) {
                lefts[first + across] = left[there + across];
                moved[first + across] = -(vector.x || vector.y);
            }
        }
        uint squares[STRIP_CELLS];
        int residuals[STRIP_CELLS], signals[STRIP_CELLS];
        const int rest = CELL_COLUMNS / PAIRED(CELL_COLUMNS), rest_of_squares = SITES > 16 ? CELL_COLUMNS : rest;
        if (SITES <= 16) add_columns(square_of, count, CELL_COLUMNS);  // these sums fit into 32 bits, too
        add_columns(sum_of, count, CELL_COLUMNS);
        add_columns(light_of, count, CELL_COLUMNS);
        for (int i = 0; i < count; i++) {
            ulong square = 0;
            for (int x = 0; x < rest_of_squares; x++) square += (uint)square_of[i * rest_of_squares + x];
            squares[i] = min(square, (ulong)UINT_MAX);
        }
        for (int i = 0; i < count; i++) {
            int sum = 0, light = 0;
            for (int x = 0; x < rest; x++) {
                sum += sum_of[i * rest + x];
                light += light_of[i * rest + x];
            }
            residuals[i] = sum;
            signals[i] = light;
        }
        for (int i = count; i < count + CELL_LANES; i++) squares[i] = residuals[i] = signals[i] = lefts[i] = moved[i] = 0;
        for (int i = 0; i < count; i += CELL_LANES) {
            const cell_ints signal = READ_PRIVATE_CELLS(cell_ints, signals + i) - SITES * black;
            const cell_ints light = signal & ALL_IF(signal > 0), level = light / SITES;
            const cell_ints before = READ_PRIVATE_CELLS(cell_ints, lefts + i);
            const wholes shot = CONVERT(light, wholes) * linear / (1 << LINEAR_FRACTION), steep = CONVERT(level, wholes);
            wholes variance = CONVERT(FLOOR(shot < most ? shot : most), wholes) + (wholes)constant_term;
            variance = (variance < most ? variance : most) * CONVERT(before + ONE, wholes) / ONE;
            const wholes pattern = CONVERT(FLOOR(steep * steep * uneven / (1 << UNEVEN_FRACTION)), wholes) + (wholes)fixed;
            const cell_ints moves = READ_PRIVATE_CELLS(cell_ints, moved + i);
            variance = CONVERT(FLOOR(variance), wholes) + 2 * SITES * pattern * CONVERT(-moves, wholes);
            variance = variance < most ? variance : most;
            const int place = cell_place(cell_row, begin * CELL_ACROSS + i, cell_columns);
            WRITE_CELLS(cell_uints, powers + place, READ_PRIVATE_CELLS(cell_uints, squares + i));
            WRITE_CELLS(cell_ints, sums + place, READ_PRIVATE_CELLS(cell_ints, residuals + i));
            WRITE_CELLS(cell_uints, variances + place, FLOOR(variance) & WITHIN(count - i));
            WRITE_CELLS(cell_shorts, left_before + place, before);
        }
    }
}

// Computes the weight and the new noise fraction of every cell in STRIP blocks, and counts the cells in which the scene has changed. `weights`
// initially contains the noise fractions of the history, which the weights overwrite.
__kernel void weigh(__global const uint *restrict powers, __global const int *restrict sums,
                    __global const uint *restrict variances, __global ushort *restrict weights,
                    __global ushort *restrict new_left, __global int *restrict cuts, int shared_in_cells,
                    int shared_nearby, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int cell_columns = block_columns * CELL_ACROSS, count = (last - begin) * CELL_ACROSS;
    const int length = cell_row_length(cell_columns);
    const wholes zero = 0, most = MOST_BEYOND;
    cell_ints others = 0;
    for (int down = 0; down < CELL_DOWN; down++)
        for (int i = 0; i < count; i += CELL_LANES) {
            const int place = cell_place(block_row * CELL_DOWN + down, begin * CELL_ACROSS + i, cell_columns);
            wholes power = 0, mean = 0, wide = 0, variance = 0;
            for (int y = -length; y <= length; y += length)
                for (int x = -1; x <= 1; x++) {
                    const wholes sum = CONVERT(READ_CELLS(cell_ints, sums + place + y + x), wholes);
                    power += CONVERT(READ_CELLS(cell_uints, powers + place + y + x), wholes);
                    mean += sum * sum;
                    wide += sum;
                    variance += CONVERT(READ_CELLS(cell_uints, variances + place + y + x), wholes);
                }
            wide *= wide;
            const cell_ints within = WITHIN(count - i);
            others -= TRUE_CELLS(power > variance * CUT) & within;
            power = power * POWER_FACTOR - variance * POWER_FREE;
            const cell_ints left = CONVERT(READ_CELLS(cell_shorts, weights + place), cell_ints);
            const wholes noisy = CONVERT(left + ONE, wholes);
            mean -= (variance + noisy * shared_in_cells) * MEAN_FREE;
            wide -= (variance + noisy * shared_nearby) * WIDE_FREE;
            wholes beyond = (power > zero ? power : zero) + (mean > zero ? mean : zero) + (wide > zero ? wide : zero);
            beyond = beyond < most ? beyond : most;
            const wholes whole = variance * noisy + beyond * ONE;
            const cell_ints rest = FLOOR(variance * (ONE * ONE) / whole), least = ONE - LEAST_WEIGHT;
            const cell_ints of_before = rest < least ? rest : least, weight = ONE - of_before, one = ONE;
            const cell_ints remains = (of_before * of_before * left + weight * weight * ONE) / (ONE * ONE) + 1;
            WRITE_CELLS(cell_shorts, weights + place, weight);
            WRITE_CELLS(cell_shorts, new_left + place, (remains < one ? remains : one) & within);
        }
    cuts[block_row * get_global_size(0) + get_global_id(0)] = SUM_CELLS(others);
}

// Blends the frame with the history. Writes the new history as integers u (new_kept), the filtered frame in DN (made), and the means of the new
// history over CFA periods (plane). If `restart` is set, the history is ignored.
__kernel void blend(__global const ushort *restrict raw, __global const ushort *restrict history,
                    __global const int2 *restrict vectors, __global const ushort *restrict weights,
                    __global const int *restrict cuts, __global ushort *restrict new_kept,
                    __global ushort *restrict new_left, __global ushort *restrict made, __global ushort *restrict plane,
                    int free_bits, int restart, int strips, int cells, int block_rows, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, cell_columns = block_columns * CELL_ACROSS;
    const int across = block_columns * UNITS_ACROSS;
    const int rounding = 1 << free_bits >> 1, most = (1 << (16 - free_bits)) - 1;
    int others = 0;
    if (!restart)
        for (int i = 0; i < strips; i++) others += cuts[i];
    const bool anew = restart || others * FEW > cells;
    for (int down = 0; down < CELL_DOWN; down++) {
        const int cell_row = block_row * CELL_DOWN + down, unit = cell_row * (CELL_ROWS / PERIOD_ROWS);
        int sums[CELL_ROWS / PERIOD_ROWS][STRIP_COLUMNS];
        for (int block = begin; block < last; block++) {
            int2 vector = (int2)(0, 0);
            if (!anew) vector = vectors[block_row * block_columns + block] * (int2)(PERIOD_ROWS, PERIOD_COLUMNS);
            int weight[BLOCK_COLUMNS];
            for (int i = 0; i < CELL_ACROSS; i++) {
                const int cell = cell_place(cell_row, block * CELL_ACROSS + i, cell_columns);
                const int own = anew ? ONE : weights[cell];
                if (anew) new_left[cell] = ONE;
                for (int x = 0; x < CELL_COLUMNS; x++) weight[i * CELL_COLUMNS + x] = own;
            }
            for (int period = 0; period < CELL_ROWS / PERIOD_ROWS; period++) {
                const int place = (unit + period) * PERIOD_ROWS * columns + block * BLOCK_COLUMNS;
                const int before = anew ? place : place + vector.x * columns + vector.y;
                for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                    ints sum = 0;
                    for (int y = 0; y < PERIOD_ROWS; y++) {
                        const int at = y * columns + x;
                        const ints value = units(READ(raw + place + at), free_bits), old = READ(history + before + at);
                        const ints new = old + ((WEIGHTS(weight + x) * (value - old) + ONE / 2) >> SHARE_BITS);
                        FETCH_NEXT(raw + place + CELL_ROWS * columns + at);
                        FETCH_NEXT(history + before + CELL_ROWS * columns + at);
                        WRITE(new_kept + place + at, new);
                        WRITE(made + place + at, least_of((new + rounding) >> free_bits, most));
                        sum += new;
                    }
                    WRITE_PRIVATE(sums[period] + (block - begin) * BLOCK_COLUMNS + x, sum);
                }
            }
        }
        for (int period = 0; period < CELL_ROWS / PERIOD_ROWS; period++) {
            const int row = (MARGIN + unit + period) * row_length(across);
            means_of(sums[period], plane + row + MARGIN + begin * UNITS_ACROSS, (last - begin) * UNITS_ACROSS);
        }
    }
    for (int unit = block_row * UNITS_DOWN; unit < (block_row + 1) * UNITS_DOWN; unit++)
        fill_beside(plane, unit, block_rows * UNITS_DOWN, across, begin * UNITS_ACROSS, last * UNITS_ACROSS);
}
