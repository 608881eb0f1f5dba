// A mosaic and what is kept of those before it → the blend of both (l3cli/rendering/temporal/ is the truth: reference.py).
//
// Whole numbers throughout, so that every device agrees. A work-item takes STRIP blocks of a row of blocks, or STRIP cells or
// periods; frames are whole blocks, `columns` wide. Values are u = DN << spare, at most 16 bits.

#define CELL_ROWS (BLOCK_ROWS / CELL_DOWN)
#define CELL_COLUMNS (BLOCK_COLUMNS / CELL_ACROSS)
#define SITES (CELL_ROWS * CELL_COLUMNS)
#define PERIOD_SITES (PERIOD_ROWS * PERIOD_COLUMNS)
#define UNITS_DOWN (BLOCK_ROWS / PERIOD_ROWS)  // of a block, in the finest plane
#define UNITS_ACROSS (BLOCK_COLUMNS / PERIOD_COLUMNS)

// Cells are taken CELL_LANES side by side. Sums over cells are beyond 32 bits: where pixels lie side by side they are doubles,
// which hold whole numbers up to 2^53 as they are and which a processor divides side by side.
#if LANES == 1
#define CELL_LANES 1
typedef int cell_ints;
typedef uint cell_uints;
typedef ushort cell_shorts;
typedef long wholes;
#define READ(p) ((int)*(p))
#define WRITE(p, value) (*(p) = value)
#define WRITE_PRIVATE(p, value) (*(p) = value)
#define WEIGHTS(p) (*(p))
#define READ_CELLS(type, p) ((type)*(p))
#define READ_PRIVATE_CELLS(type, p) ((type)*(p))
#define WRITE_CELLS(type, p, value) (*(p) = (type)(value))
#define ALL_IF(condition) (-(condition))
#define TRUE_CELLS(condition) (-(condition))
#define WITHIN(count) (-((count) > 0))
#define SUM_CELLS(value) (value)
#define FLOOR(value) ((int)(value))
#else
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define CELL_LANES 8
VECTOR(ushort, eight_shorts, 8);
VECTOR(int, eight_ints, 8);
VECTOR(int, four_ints, 4);
VECTOR(int, two_ints, 2);
VECTOR(ushort, cell_shorts, CELL_LANES);
VECTOR(int, cell_ints, CELL_LANES);
VECTOR(uint, cell_uints, CELL_LANES);
VECTOR(double, wholes, CELL_LANES);
#define READ(p) CONVERT(LOAD_GLOBAL(shorts, p), ints)
#define WRITE(p, value) (STORE_GLOBAL(shorts, p) = CONVERT(value, shorts))
#define WRITE_PRIVATE(p, value) (STORE_PRIVATE(ints, p) = value)
#define WEIGHTS(p) LOAD_PRIVATE(ints, p)
#define READ_CELLS(type, p) LOAD_GLOBAL(type, p)
#define READ_PRIVATE_CELLS(type, p) LOAD_PRIVATE(type, p)
#define WRITE_CELLS(type, p, value) (STORE_GLOBAL(type, p) = CONVERT(value, type))
#define ALL_IF(condition) (condition)  // all bits, or none, lane by lane
#define TRUE_CELLS(condition) CONVERT(condition, cell_ints)  // the same of doubles
#define FLOOR(value) CONVERT(value, cell_ints)  // of what is not below 0

// All bits of the lanes that are among so many.
INLINE cell_ints WITHIN(int count) {
    const cell_ints lane = {0, 1, 2, 3, 4, 5, 6, 7}, limit = count;
    return lane < limit;
}

INLINE int SUM_CELLS(cell_ints value) {
    const four_ints four = value.lo + value.hi;
    const two_ints two = four.lo + four.hi;
    return two.x + two.y;
}
#endif
#define STRIP_CELLS (STRIP * CELL_ACROSS + CELL_LANES)

INLINE ints least_of(ints a, int b) {
    const ints other = b;
    return a < other ? a : other;
}

INLINE ints most_of(ints a, int b) {
    const ints other = b;
    return a > other ? a : other;
}

// Values as u.
INLINE ints units(ints value, int spare) { return least_of(value, (1 << (16 - spare)) - 1) << spare; }

// Planes have MARGIN rows and columns about them that repeat their edge, and rows of SLACK columns more, so that windows, and
// vectors that begin in one, may go beyond.
INLINE int row_length(int columns) { return columns + 2 * MARGIN + SLACK; }

INLINE void fill_margin(__global ushort *row, int columns, bool left, bool right) {
    for (int x = 0; left && x < MARGIN; x++) row[x] = row[MARGIN];
    for (int x = MARGIN + columns; right && x < row_length(columns); x++) row[x] = row[MARGIN + columns - 1];
}

// What a plane has beside units `first` to `last` of a row of it.
INLINE void fill_beside(__global ushort *plane, int row, int rows, int columns, int first, int last) {
    const int length = row_length(columns), from = first ? MARGIN + first : 0, to = last < columns ? MARGIN + last : length;
    __global ushort *line = plane + (MARGIN + row) * length;
    fill_margin(line, columns, first == 0, last == columns);
    for (int i = 1; i <= MARGIN; i++) {
        if (row == 0)
            for (int x = from; x < to; x++) line[x - i * length] = line[x];
        if (row == rows - 1)
            for (int x = from; x < to; x++) line[x + i * length] = line[x];
    }
}

// Means over a period of a block's columns, whose sums over the rows of one are given.
INLINE void means_of(const int *columns, __global ushort *plane) {
    int sums[UNITS_ACROSS];
    for (int i = 0; i < UNITS_ACROSS; i++) sums[i] = PERIOD_SITES / 2;
    for (int x = 0; x < PERIOD_COLUMNS; x++)
        for (int i = 0; i < UNITS_ACROSS; i++) sums[i] += columns[i * PERIOD_COLUMNS + x];
    for (int i = 0; i < UNITS_ACROSS; i++) plane[i] = (uint)sums[i] / PERIOD_SITES;
}

// Means over a period, of STRIP blocks of a row of them.
__kernel void means(__global const ushort *restrict values, __global ushort *restrict plane, int spare, int block_rows,
                    int block_columns) {
    const int block_row = get_global_id(1), first = get_global_id(0) * STRIP, last = min(first + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, across = block_columns * UNITS_ACROSS;
    for (int unit = 0; unit < UNITS_DOWN; unit++) {
        const int row = block_row * UNITS_DOWN + unit;
        for (int block = first; block < last; block++) {
            __global const ushort *corner = values + row * PERIOD_ROWS * columns + block * BLOCK_COLUMNS;
            int down[BLOCK_COLUMNS];
            for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                ints sum = 0;
                for (int y = 0; y < PERIOD_ROWS; y++) sum += units(READ(corner + y * columns + x), spare);
                WRITE_PRIVATE(down + x, sum);
            }
            means_of(down, plane + (MARGIN + row) * row_length(across) + MARGIN + block * UNITS_ACROSS);
        }
        fill_beside(plane, row, block_rows * UNITS_DOWN, across, first * UNITS_ACROSS, last * UNITS_ACROSS);
    }
}

// Means of two by two of a plane whose rows are `wide`.
__kernel void halve(__global const ushort *restrict fine, __global ushort *restrict coarse, int wide, int rows, int columns) {
    const int line = get_global_id(1), row = clamp(line - MARGIN, 0, rows - 1);
    const int first = get_global_id(0) * STRIP, last = min(first + STRIP, columns);
    __global const ushort *above = fine + (2 * row + MARGIN) * row_length(wide) + MARGIN, *below = above + row_length(wide);
    coarse += line * row_length(columns);
    for (int column = first; column < last; column++) {
        const int left = 2 * column;
        coarse[MARGIN + column] = (above[left] + above[left + 1] + below[left] + below[left + 1] + 2) >> 2;
    }
    fill_margin(coarse, columns, first == 0, last == columns);
}

typedef struct {
    __global const ushort *now, *before;  // where the window begins
    int2 window;                          // rows and columns
    int length;                           // of the planes' rows
} Search;

// The sum of a window's values.
INLINE int light_in(const Search *s) {
    int sum = 0;
    for (int y = 0; y < s->window.x; y++)
        for (int x = 0; x < s->window.y; x++) sum += s->now[y * s->length + x];
    return sum;
}

// The sum of differences, each of them at most MOST_DIFFERENCE; where it is not below `limit`, something that is not, either.
INLINE int cost(const Search *s, int2 vector, int limit) {
    __global const ushort *now = s->now, *before = s->before + vector.x * s->length + vector.y;
#if LANES == 1
    int sum = 0;
    for (int y = 0; y < s->window.x && sum < limit; y++, now += s->length, before += s->length)
        for (int x = 0; x < s->window.y; x++) sum += min(abs_diff((int)now[x], (int)before[x]), (uint)MOST_DIFFERENCE);
    return sum;
#else
    const eight_ints lane = {0, 1, 2, 3, 4, 5, 6, 7};
    const eight_shorts most = MOST_DIFFERENCE;
    eight_ints sums = 0;
    for (int x = 0; x < s->window.y; x += 8) {
        const eight_ints left = s->window.y - x, within = lane < left;  // all bits, or none
        eight_shorts column = 0;  // of at most 16 rows
        for (int y = 0; y < s->window.x; y++) {
            const eight_shorts a = LOAD_GLOBAL(eight_shorts, now + y * s->length + x);
            const eight_shorts b = LOAD_GLOBAL(eight_shorts, before + y * s->length + x);
            const eight_shorts difference = (a > b ? a : b) - (a < b ? a : b);
            column += difference < most ? difference : most;
        }
        sums += CONVERT(column, eight_ints) & within;
    }
    const four_ints four = sums.lo + sums.hi;
    const two_ints two = four.lo + four.hi;
    return two.x + two.y;
#endif
}

typedef struct {
    int2 vector;
    int cost;
} Best;

INLINE Best better(const Search *s, Best best, int2 vector, int reluctance) {
    if (all(vector == best.vector)) return best;
    const int sum = cost(s, vector, best.cost) + reluctance;
    if (sum < best.cost) best = (Best){vector, sum};
    return best;
}

// The vector of every block, in units of planes of one level, of those of the coarser one.
__kernel void search(__global const ushort *restrict now, __global const ushort *restrict before,
                     __global const int2 *restrict parents, __global int2 *restrict vectors,
                     __global const int *restrict spread, int level, int coarsest, int2 size, int2 window, int root,
                     int block_rows, int block_columns) {
    const int row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int2 period = (int2)(PERIOD_ROWS, PERIOD_COLUMNS), unit = period << level;
    const int2 block = (int2)(BLOCK_ROWS, BLOCK_COLUMNS), frame = (int2)(block_rows, block_columns) * block;
    const int length = row_length(size.y);
    for (int column = begin; column < last; column++) {
        const int2 corner = (int2)(row, column) * block, least = -(corner / unit), most = (frame - block - corner) / unit;
        const int2 first = corner / unit - (window - block / unit) / 2 + MARGIN;
        const int from = first.x * length + first.y;
        const Search s = {now + from, before + from, window, length};
        const int noise = spread[light_in(&s) / (window.x * window.y) >> 8];
        const int reluctance = noise * (5 * RELUCTANCE * root) >> (7 + level);
        const int settled = noise * (SETTLED * window.x * window.y) >> (3 + level);
        Best best = {(int2)(0, 0), INT_MAX};
        best.cost = cost(&s, best.vector, INT_MAX);
        if (!coarsest && best.cost > settled) {
            const int2 places[5] = {(int2)(row, column), (int2)(max(row - 1, 0), column),
                                    (int2)(min(row + 1, block_rows - 1), column), (int2)(row, max(column - 1, 0)),
                                    (int2)(row, min(column + 1, block_columns - 1))};
            const int least_cost = best.cost;
            int2 tried = best.vector;
            for (int i = 0; i < 5; i++) {
                const int2 parent = clamp(parents[places[i].x * block_columns + places[i].y] * 2, least, most);
                if (any(parent != tried)) best = better(&s, best, parent, reluctance);
                tried = parent;
            }
            best.cost = all(best.vector == 0) ? least_cost : best.cost - reluctance;
        }
        if (best.cost > settled) {
            const int2 start = best.vector;
            const int reach = coarsest ? FARTHEST : 1;
            for (int y = -reach; y <= reach; y++)
                for (int x = -reach; x <= reach; x++)
                    if (x || y) best = better(&s, best, clamp(start + (int2)(y, x), least, most), reluctance);
        }
        vectors[row * block_columns + column] = best.vector;
    }
}

// Cells have SLACK beside them, and a row above and below them, of nought.
INLINE int cell_row_length(int columns) { return columns + 2 * SLACK; }

INLINE int cell_place(int row, int column, int cell_columns) {
    return (row + 1) * cell_row_length(cell_columns) + SLACK + column;
}

// How many cells on a middle of a cell was before: `vector` is in pixels.
INLINE int2 cells_on(int2 vector) {
    const int2 side = (int2)(CELL_ROWS, CELL_COLUMNS), far = 4096;  // a vector is not so many cells: none is divided below 0
    return (side / 2 + vector + far * side) / side - far;
}

// Of every cell of STRIP blocks the power of its residuals, their sum, what noise makes of either, and what was left of the
// noise where its middle was before.
__kernel void evidence(__global const ushort *restrict raw, __global const ushort *restrict kept,
                       __global const int2 *restrict vectors, __global const ushort *restrict left,
                       __global uint *restrict powers, __global int *restrict sums, __global uint *restrict variances,
                       __global ushort *restrict left_before, int spare, int black, int linear, int constant_term,
                       int fixed, int uneven, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, cell_columns = block_columns * CELL_ACROSS;
    const int count = (last - begin) * CELL_ACROSS;
    const wholes most = MOST_VARIANCE;
    for (int down = 0; down < CELL_DOWN; down++) {
        const int cell_row = block_row * CELL_DOWN + down;
        uint squares[STRIP_CELLS];
        int residuals[STRIP_CELLS], signals[STRIP_CELLS], lefts[STRIP_CELLS], moved[STRIP_CELLS];
        for (int block = begin; block < last; block++) {
            const int2 vector = vectors[block_row * block_columns + block] * (int2)(PERIOD_ROWS, PERIOD_COLUMNS);
            const int2 on = cells_on(vector);
            __global const ushort *now = raw + cell_row * CELL_ROWS * columns + block * BLOCK_COLUMNS;
            __global const ushort *before = kept + (cell_row * CELL_ROWS + vector.x) * columns + block * BLOCK_COLUMNS + vector.y;
            uint square_of[BLOCK_COLUMNS];
            int sum_of[BLOCK_COLUMNS], light_of[BLOCK_COLUMNS];
            for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                ints square = 0, sum = 0, light = 0;  // squares fit 32 bits without a sign
                for (int y = 0; y < CELL_ROWS; y++) {
                    const ints value = units(READ(now + y * columns + x), spare);
                    const ints residual = least_of(most_of(value - READ(before + y * columns + x), -CLIPPED), CLIPPED);
                    square += residual * residual;
                    sum += residual;
                    light += value;
                }
                WRITE_PRIVATE((int *)square_of + x, square);
                WRITE_PRIVATE(sum_of + x, sum);
                WRITE_PRIVATE(light_of + x, light);
            }
            const int first = (block - begin) * CELL_ACROSS;
            const int there = cell_place(cell_row + on.x, block * CELL_ACROSS + on.y, cell_columns);
            for (int across = 0; across < CELL_ACROSS; across++) {
                ulong square = 0;
                int sum = 0, light = 0;
                for (int x = across * CELL_COLUMNS; x < (across + 1) * CELL_COLUMNS; x++) {
                    square += square_of[x];
                    sum += sum_of[x];
                    light += light_of[x];
                }
                squares[first + across] = min(square, (ulong)UINT_MAX);
                residuals[first + across] = sum;
                signals[first + across] = light;
                lefts[first + across] = left[there + across];
                moved[first + across] = -(vector.x || vector.y);
            }
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

// Of every cell its weight and what is left of its noise, and of STRIP blocks how many cells are of another scene. `weights`
// are what was left before, and become weights.
__kernel void weigh(__global const uint *restrict powers, __global const int *restrict sums,
                    __global const uint *restrict variances, __global ushort *restrict weights,
                    __global ushort *restrict new_left, __global int *restrict cuts, int block_columns) {
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
            mean -= variance * MEAN_FREE;
            wide -= variance * WIDE_FREE;
            wholes beyond = (power > zero ? power : zero) + (mean > zero ? mean : zero) + (wide > zero ? wide : zero);
            beyond = beyond < most ? beyond : most;
            const cell_ints left = CONVERT(READ_CELLS(cell_shorts, weights + place), cell_ints);
            const wholes whole = variance * CONVERT(left + ONE, wholes) + beyond * ONE;
            const cell_ints rest = FLOOR(variance * (ONE * ONE) / whole), least = ONE - LEAST_WEIGHT;
            const cell_ints of_before = rest < least ? rest : least, weight = ONE - of_before, one = ONE;
            const cell_ints remains = (of_before * of_before * left + weight * weight * ONE) / (ONE * ONE) + 1;
            WRITE_CELLS(cell_shorts, weights + place, weight);
            WRITE_CELLS(cell_shorts, new_left + place, (remains < one ? remains : one) & within);
        }
    cuts[block_row * get_global_size(0) + get_global_id(0)] = SUM_CELLS(others);
}

// The blend, as u to be kept and as DN, and the means over a period of what is kept. `restart`: nothing is taken from before.
__kernel void blend(__global const ushort *restrict raw, __global const ushort *restrict kept,
                    __global const int2 *restrict vectors, __global const ushort *restrict weights,
                    __global const int *restrict cuts, __global ushort *restrict new_kept,
                    __global ushort *restrict new_left, __global ushort *restrict made, __global ushort *restrict plane,
                    int spare, int restart, int strips, int cells, int block_rows, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, cell_columns = block_columns * CELL_ACROSS;
    const int across = block_columns * UNITS_ACROSS;
    const int rounding = 1 << spare >> 1, most = (1 << (16 - spare)) - 1;
    int others = 0;
    if (!restart)
        for (int i = 0; i < strips; i++) others += cuts[i];
    const bool anew = restart || others * FEW > cells;
    for (int down = 0; down < CELL_DOWN; down++) {
        const int cell_row = block_row * CELL_DOWN + down;
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
            for (int y = 0; y < CELL_ROWS; y += PERIOD_ROWS) {
                const int row = cell_row * CELL_ROWS + y, place = row * columns + block * BLOCK_COLUMNS;
                const int before = anew ? place : place + vector.x * columns + vector.y;
                int sums[BLOCK_COLUMNS];
                for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                    ints sum = 0;
                    for (int i = 0; i < PERIOD_ROWS; i++) {
                        const int at = i * columns + x;
                        const ints value = units(READ(raw + place + at), spare), old = READ(kept + before + at);
                        const ints new = old + ((WEIGHTS(weight + x) * (value - old) + ONE / 2) >> SHARE_BITS);
                        WRITE(new_kept + place + at, new);
                        WRITE(made + place + at, least_of((new + rounding) >> spare, most));
                        sum += new;
                    }
                    WRITE_PRIVATE(sums + x, sum);
                }
                const int unit = row / PERIOD_ROWS;
                means_of(sums, plane + (MARGIN + unit) * row_length(across) + MARGIN + block * UNITS_ACROSS);
            }
        }
    }
    for (int unit = block_row * UNITS_DOWN; unit < (block_row + 1) * UNITS_DOWN; unit++)
        fill_beside(plane, unit, block_rows * UNITS_DOWN, across, begin * UNITS_ACROSS, last * UNITS_ACROSS);
}
