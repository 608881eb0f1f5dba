// A mosaic and what is kept of those before it → the blend of both (l3cli/rendering/temporal/ is the truth: reference.py).
//
// Whole numbers throughout, so that every device agrees. A work-item takes STRIP blocks of a row of blocks, or STRIP cells or
// periods; frames are whole blocks, `columns` wide. Values are u = DN << spare, at most 16 bits.

#define CELL_ROWS (BLOCK_ROWS / CELL_DOWN)
#define CELL_COLUMNS (BLOCK_COLUMNS / CELL_ACROSS)
#define SITES (CELL_ROWS * CELL_COLUMNS)
#define PERIOD_SITES (PERIOD_ROWS * PERIOD_COLUMNS)

#if LANES > 1
VECTOR(ushort, eight_shorts, 8);
VECTOR(int, eight_ints, 8);
#endif

#if LANES == 1
#define READ(p) ((int)*(p))
#define WRITE(p, value) (*(p) = value)
#define WRITE_PRIVATE(p, value) (*(p) = value)
#define WEIGHTS(p) (*(p))
#else
#define READ(p) CONVERT(LOAD_GLOBAL(shorts, p), ints)
#define WRITE(p, value) (STORE_GLOBAL(shorts, p) = CONVERT(value, shorts))
#define WRITE_PRIVATE(p, value) (STORE_PRIVATE(ints, p) = value)
#define WEIGHTS(p) LOAD_PRIVATE(ints, p)
#endif

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

// Means over a period, of STRIP blocks of a row of a plane, its margin included.
__kernel void means(__global const ushort *restrict values, __global ushort *restrict plane, int spare, int rows,
                    int block_columns) {
    const int line = get_global_id(1), row = clamp(line - MARGIN, 0, rows - 1);
    const int first = get_global_id(0) * STRIP, last = min(first + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, units_across = BLOCK_COLUMNS / PERIOD_COLUMNS;
    plane += line * row_length(block_columns * units_across);
    for (int block = first; block < last; block++) {
        __global const ushort *corner = values + row * PERIOD_ROWS * columns + block * BLOCK_COLUMNS;
        int down[BLOCK_COLUMNS];
        for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
            ints sum = 0;
            for (int y = 0; y < PERIOD_ROWS; y++) sum += units(READ(corner + y * columns + x), spare);
            WRITE_PRIVATE(down + x, sum);
        }
        for (int i = 0; i < units_across; i++) {
            int sum = PERIOD_SITES / 2;
            for (int x = 0; x < PERIOD_COLUMNS; x++) sum += down[i * PERIOD_COLUMNS + x];
            plane[MARGIN + block * units_across + i] = sum / PERIOD_SITES;
        }
    }
    fill_margin(plane, block_columns * units_across, first == 0, last == block_columns);
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

// The sum of differences; where it is not below `limit`, something that is not, either.
INLINE int cost(const Search *s, int2 vector, int limit) {
    __global const ushort *now = s->now, *before = s->before + vector.x * s->length + vector.y;
    int sum = 0;
#if LANES == 1
    for (int y = 0; y < s->window.x && sum < limit; y++, now += s->length, before += s->length)
        for (int x = 0; x < s->window.y; x++) sum += abs_diff((int)now[x], (int)before[x]);
#else
    const eight_ints lane = {0, 1, 2, 3, 4, 5, 6, 7};
    eight_ints sums = 0;
    for (int x = 0; x < s->window.y; x += 8) {
        const eight_ints left = s->window.y - x, within = lane < left;  // all bits, or none
        for (int y = 0; y < s->window.x; y++) {
            const eight_ints a = CONVERT(LOAD_GLOBAL(eight_shorts, now + y * s->length + x), eight_ints);
            const eight_ints b = CONVERT(LOAD_GLOBAL(eight_shorts, before + y * s->length + x), eight_ints);
            sums += (a > b ? a - b : b - a) & within;
        }
    }
    for (int i = 0; i < 8; i++) sum += sums[i];
#endif
    return sum;
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
        int sum = 0;
        for (int y = 0; y < window.x; y++)
            for (int x = 0; x < window.y; x++) sum += s.now[y * length + x];
        const int reluctance = spread[sum / (window.x * window.y) >> 8] * (5 * RELUCTANCE * root) >> (7 + level);
        Best best = {(int2)(0, 0), INT_MAX};
        best.cost = cost(&s, best.vector, INT_MAX);
        if (!coarsest) {
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
        const int2 start = best.vector;
        const int reach = coarsest ? FARTHEST : 1;
        for (int y = -reach; y <= reach; y++)
            for (int x = -reach; x <= reach; x++)
                if (x || y) best = better(&s, best, clamp(start + (int2)(y, x), least, most), reluctance);
        vectors[row * block_columns + column] = best.vector;
    }
}

// What is left of the noise in a cell, of where its middle was before.
INLINE int left_before(__global const ushort *left, int2 cell, int2 vector, int cell_columns) {
    const int2 side = (int2)(CELL_ROWS, CELL_COLUMNS), place = (cell * side + side / 2 + vector) / side;
    return left[place.x * cell_columns + place.y];
}

// Of every cell the power of its residuals, their sum, and what noise makes of the power of either.
__kernel void evidence(__global const ushort *restrict raw, __global const ushort *restrict kept,
                       __global const int2 *restrict vectors, __global const ushort *restrict left,
                       __global ulong *restrict found, int spare, int black, int linear, int base, ulong fixed,
                       ulong uneven, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, cell_columns = block_columns * CELL_ACROSS;
    for (int block = begin; block < last; block++) {
        const int2 period = (int2)(PERIOD_ROWS, PERIOD_COLUMNS);
        const int2 vector = vectors[block_row * block_columns + block] * period;
        for (int down = 0; down < CELL_DOWN; down++) {
            const int cell_row = block_row * CELL_DOWN + down;
            __global const ushort *now = raw + cell_row * CELL_ROWS * columns + block * BLOCK_COLUMNS;
            __global const ushort *before = kept + (cell_row * CELL_ROWS + vector.x) * columns + block * BLOCK_COLUMNS + vector.y;
            int squares[BLOCK_COLUMNS], sums[BLOCK_COLUMNS], signals[BLOCK_COLUMNS];
            for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                ints square = 0, sum = 0, light = 0;  // squares fit 32 bits without a sign
                for (int y = 0; y < CELL_ROWS; y++) {
                    const ints value = units(READ(now + y * columns + x), spare);
                    const ints residual = least_of(most_of(value - READ(before + y * columns + x), -CLIPPED), CLIPPED);
                    square += residual * residual;
                    sum += residual;
                    light += value;
                }
                WRITE_PRIVATE(squares + x, square);
                WRITE_PRIVATE(sums + x, sum);
                WRITE_PRIVATE(signals + x, light);
            }
            for (int across = 0; across < CELL_ACROSS; across++) {
                ulong power = 0;
                long sum = 0;
                int signal = -SITES * black;
                for (int x = across * CELL_COLUMNS; x < (across + 1) * CELL_COLUMNS; x++) {
                    power += (uint)squares[x];
                    sum += sums[x];
                    signal += signals[x];
                }
                const ulong light = max(signal, 0), level = light / SITES;
                const int2 cell = (int2)(cell_row, block * CELL_ACROSS + across);
                ulong variance = (light * linear >> LINEAR_FRACTION) + (ulong)SITES * base;
                variance = variance * (ONE + left_before(left, cell, vector, cell_columns)) / ONE;
                if (vector.x || vector.y) variance += 2 * SITES * (fixed + (level * level * uneven >> UNEVEN_FRACTION));
                __global ulong *own = found + 3 * (cell.x * cell_columns + cell.y);
                own[0] = power, own[1] = (ulong)sum, own[2] = variance;
            }
        }
    }
}

// Evidence of three cells, one below the other, as far as there are.
INLINE ulong4 down(__global const ulong *found, int above, int below, int column, int cell_columns) {
    ulong4 sum = 0;
    for (int row = above; row <= below; row++) {
        const ulong3 cell = vload3(row * cell_columns + column, found);
        sum += (ulong4)(cell.x, cell.y * cell.y, cell.y, cell.z);  // of a sum below zero, too, the product is right
    }
    return sum;
}

// Of every cell its weight, and of every strip how many cells are of another scene.
__kernel void weigh(__global const ulong *restrict found, __global const int2 *restrict vectors,
                    __global const ushort *restrict left, __global ushort *restrict weights, __global int *restrict cuts,
                    int cell_rows, int cell_columns) {
    const int row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, cell_columns);
    int others = 0;
    const int above = max(row - 1, 0), below = min(row + 1, cell_rows - 1);
    ulong4 left_side = 0, middle = 0, right_side = begin ? down(found, above, below, begin - 1, cell_columns) : (ulong4)(0);
    for (int column = begin - 1; column < last; column++) {
        left_side = middle, middle = right_side;
        right_side = column + 1 < cell_columns ? down(found, above, below, column + 1, cell_columns) : (ulong4)(0);
        if (column < begin) continue;
        const ulong4 around = left_side + middle + right_side;
        const ulong power = around.x, mean = around.y, wide = around.z * around.z, variance = around.w;
        const int powers = min(power * ONE / variance, (ulong)MOST), means = min(mean * ONE / variance, (ulong)MOST);
        const int wides = min(wide * ONE / variance, (ulong)MOST);
        others += powers > CUT;
        const int beyond = max(powers - POWER_FREE, 0) * POWER_FACTOR + max(means - MEAN_FREE, 0) * MEAN_FACTOR +
                           max(wides - WIDE_FREE, 0) * WIDE_FACTOR;
        const int block = row / CELL_DOWN * (cell_columns / CELL_ACROSS) + column / CELL_ACROSS;
        const int2 vector = vectors[block] * (int2)(PERIOD_ROWS, PERIOD_COLUMNS);
        const int prior = left_before(left, (int2)(row, column), vector, cell_columns) + beyond;
        weights[row * cell_columns + column] = max(ONE * prior / (ONE + prior), LEAST_WEIGHT);
    }
    cuts[row * get_global_size(0) + get_global_id(0)] = others;
}

// The blend, as u to be kept and as DN, and what is left of the noise. `restart`: nothing is taken from before.
__kernel void blend(__global const ushort *restrict raw, __global const ushort *restrict kept,
                    __global const int2 *restrict vectors, __global const ushort *restrict left,
                    __global const ushort *restrict weights, __global const int *restrict cuts,
                    __global ushort *restrict new_kept, __global ushort *restrict new_left, __global ushort *restrict made,
                    int spare, int restart, int strips, int cells, int block_columns) {
    const int block_row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, cell_columns = block_columns * CELL_ACROSS;
    const int rounding = 1 << spare >> 1, most = (1 << (16 - spare)) - 1;
    int others = 0;
    if (!restart)
        for (int i = 0; i < strips; i++) others += cuts[i];
    const bool anew = restart || others * FEW > cells;
    for (int block = begin; block < last; block++) {
        int2 vector = (int2)(0, 0);
        if (!anew) vector = vectors[block_row * block_columns + block] * (int2)(PERIOD_ROWS, PERIOD_COLUMNS);
        for (int down = 0; down < CELL_DOWN; down++) {
            const int cell_row = block_row * CELL_DOWN + down;
            int weight[BLOCK_COLUMNS];
            for (int across = 0; across < CELL_ACROSS; across++) {
                const int cell = cell_row * cell_columns + block * CELL_ACROSS + across;
                const int own = anew ? ONE : weights[cell];
                if (anew) {
                    new_left[cell] = ONE;
                } else {
                    const uint there = left_before(left, (int2)(cell_row, block * CELL_ACROSS + across), vector, cell_columns);
                    const uint rest = ONE - own;
                    new_left[cell] = min((rest * rest * there + (uint)(own * own) * ONE) / (ONE * ONE) + 1, (uint)ONE);
                }
                for (int x = 0; x < CELL_COLUMNS; x++) weight[across * CELL_COLUMNS + x] = own;
            }
            const int start = cell_row * CELL_ROWS * columns + block * BLOCK_COLUMNS;
            for (int y = 0; y < CELL_ROWS; y++) {
                const int place = start + y * columns;
                __global const ushort *before = kept + place + vector.x * columns + vector.y;
                for (int x = 0; x < BLOCK_COLUMNS; x += LANES) {
                    const ints value = units(READ(raw + place + x), spare), old = READ(before + x);
                    const ints new = old + ((WEIGHTS(weight + x) * (value - old) + ONE / 2) >> SHARE_BITS);
                    WRITE(new_kept + place + x, new);
                    WRITE(made + place + x, least_of((new + rounding) >> spare, most));
                }
            }
        }
    }
}
