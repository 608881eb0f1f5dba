// Where each block was in what is kept (l3cli/rendering/temporal/motion.py): planes of means, and the search in them.

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

#if LANES == 1
#define PAIRED(columns) 1
#else
#define PAIRED(columns) ((columns) % 4 == 0 ? 4 : (columns) % 2 == 0 ? 2 : 1)  // of them that are added side by side

// `count` sums of two neighbours, in the place of these.
INLINE void add_neighbours(int *values, int count) {
    for (int i = 0; i < count; i += LANES) {
        const ints a = LOAD_PRIVATE(ints, values + 2 * i), b = LOAD_PRIVATE(ints, values + 2 * i + LANES);
        const ints even = __builtin_shufflevector(a, b, ALL_LANES(EVEN)), odd = __builtin_shufflevector(a, b, ALL_LANES(ODD));
        STORE_PRIVATE(ints, values + i) = even + odd;
    }
}
#endif
#define STRIP_COLUMNS (STRIP * BLOCK_COLUMNS + 2 * LANES)

// Sums of so many columns, as far as they are added side by side, in the place of these; `count` of them in the end.
INLINE void add_columns(int *values, int count, int columns) {
#if LANES > 1
    if (PAIRED(columns) > 1) add_neighbours(values, count * columns / 2);
    if (PAIRED(columns) > 2) add_neighbours(values, count * columns / 4);
#endif
}

// `count` means over a period, side by side, of the sums of columns over the rows of one, which are lost.
INLINE void means_of(int *columns, __global ushort *plane, int count) {
    const int rest = PERIOD_COLUMNS / PAIRED(PERIOD_COLUMNS);
    add_columns(columns, count, PERIOD_COLUMNS);
    for (int i = 0; i < count; i++) {
        int sum = PERIOD_SITES / 2;
        for (int x = 0; x < rest; x++) sum += columns[i * rest + x];
        plane[i] = (uint)sum / PERIOD_SITES;
    }
}

// Means over a period, of STRIP blocks of a row of them.
__kernel void means(__global const ushort *restrict values, __global ushort *restrict plane, int spare, int block_rows,
                    int block_columns) {
    const int block_row = get_global_id(1), first = get_global_id(0) * STRIP, last = min(first + STRIP, block_columns);
    const int columns = block_columns * BLOCK_COLUMNS, across = block_columns * UNITS_ACROSS;
    for (int unit = 0; unit < UNITS_DOWN; unit++) {
        const int row = block_row * UNITS_DOWN + unit;
        __global const ushort *corner = values + row * PERIOD_ROWS * columns + first * BLOCK_COLUMNS;
        int sums[STRIP_COLUMNS];
        for (int x = 0; x < (last - first) * BLOCK_COLUMNS; x += LANES) {
            ints sum = 0;
            for (int y = 0; y < PERIOD_ROWS; y++) sum += units(READ(corner + y * columns + x), spare);
            WRITE_PRIVATE(sums + x, sum);
        }
        means_of(sums, plane + (MARGIN + row) * row_length(across) + MARGIN + first * UNITS_ACROSS, (last - first) * UNITS_ACROSS);
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
