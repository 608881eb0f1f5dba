// Temporal filter: motion of each block relative to the history (l3cli/rendering/temporal/motion.py). The kernels compute an image pyramid and
// search for motion in its planes.

// Planes have a margin of MARGIN rows and columns, in which the edge is repeated, and PADDING additional columns. Windows, and vectors that begin
// in a window, may therefore extend beyond the edge.
INLINE int row_length(int columns) { return columns + 2 * MARGIN + PADDING; }

INLINE void fill_margin(__global ushort *row, int columns, bool left, bool right) {
    for (int x = 0; left && x < MARGIN; x++) row[x] = row[MARGIN];
    for (int x = MARGIN + columns; right && x < row_length(columns); x++) row[x] = row[MARGIN + columns - 1];
}

// Fills the margin next to samples `first` to `last` of a row, if they are at an edge of the plane.
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
#define PAIRED(columns) ((columns) % 4 == 0 ? 4 : (columns) % 2 == 0 ? 2 : 1)  // number of adjacent columns that vectors add up

// Replaces 2 · count values with the sums of `count` adjacent pairs.
INLINE void add_neighbours(int *values, int count) {
    for (int i = 0; i < count; i += LANES) {
        const ints a = LOAD_PRIVATE(ints, values + 2 * i), b = LOAD_PRIVATE(ints, values + 2 * i + LANES);
        const ints even = __builtin_shufflevector(a, b, ALL_LANES(EVEN)), odd = __builtin_shufflevector(a, b, ALL_LANES(ODD));
        STORE_PRIVATE(ints, values + i) = even + odd;
    }
}
#endif
#define STRIP_COLUMNS (STRIP * BLOCK_COLUMNS + 2 * LANES)

// Replaces values with sums of adjacent columns. This reduces each of `count` groups from `columns` values to columns / PAIRED(columns) values.
INLINE void add_columns(int *values, int count, int columns) {
#if LANES > 1
    if (PAIRED(columns) > 1) add_neighbours(values, count * columns / 2);
    if (PAIRED(columns) > 2) add_neighbours(values, count * columns / 4);
#endif
}

// Computes `count` means over CFA periods. `columns` contains the column sums over the rows of a period, and is overwritten.
INLINE void means_of(int *columns, __global ushort *plane, int count) {
    const int rest = PERIOD_COLUMNS / PAIRED(PERIOD_COLUMNS);
    add_columns(columns, count, PERIOD_COLUMNS);
    for (int i = 0; i < count; i++) {
        int sum = PERIOD_SITES / 2;
        for (int x = 0; x < rest; x++) sum += columns[i * rest + x];
        plane[i] = (uint)sum / PERIOD_SITES;
    }
}

#define DEEPEST (1 << (PLANES - 1))  // ratio of resolutions of the finest and coarsest planes

INLINE int2 size_of(int level, int block_rows, int block_columns) {
    return (int2)(block_rows * UNITS_DOWN, block_columns * UNITS_ACROSS) >> level;
}

// Offset of a plane in the array of the whole pyramid.
INLINE int begin_of(int level, int block_rows, int block_columns) {
    int begin = 0;
    for (int finer = 0; finer < level; finer++) {
        const int2 size = size_of(finer, block_rows, block_columns);
        begin += (size.x + 2 * MARGIN) * row_length(size.y);
    }
    return begin;
}

// Computes samples `first` to `last` in a row of the finest plane, which contains means over CFA periods.
INLINE void means(__global const ushort *values, __global ushort *plane, int row, int first, int last, int free_bits, int across) {
    const int columns = across * PERIOD_COLUMNS, count = (last - first) * PERIOD_COLUMNS;
    int sums[STRIP_COLUMNS];
    values += row * PERIOD_ROWS * columns + first * PERIOD_COLUMNS;
    for (int x = 0; x < count; x += LANES) {
        ints sum = 0;
        for (int y = 0; y < PERIOD_ROWS; y++) {
            sum += units(READ(values + y * columns + x), free_bits);
            FETCH_NEXT(values + (PERIOD_ROWS + y) * columns + x);
        }
        WRITE_PRIVATE(sums + x, sum);
    }
    means_of(sums, plane + (MARGIN + row) * row_length(across) + MARGIN + first, last - first);
}

// Computes samples `first` to `last` in a row of a coarser plane, as means of 2 × 2 samples of the finer plane, which has `wide` columns.
INLINE void halve(__global const ushort *fine, __global ushort *coarse, int row, int first, int last, int wide, int across) {
    __global const ushort *above = fine + (2 * row + MARGIN) * row_length(wide) + MARGIN, *below = above + row_length(wide);
    coarse += (MARGIN + row) * row_length(across) + MARGIN;
    for (int column = first; column < last; column++) {
        const int left = 2 * column;
        coarse[column] = (above[left] + above[left + 1] + below[left] + below[left + 1] + 2) >> 2;
    }
}

// Computes both image pyramids. Each work-item processes DEEPEST rows of the finest plane, and is STRIP blocks wide. The first half of the
// work-items computes the pyramid of the frame. The second half computes the coarser planes of the history. Its finest plane already exists.
__kernel void planes(__global const ushort *restrict raw, __global ushort *restrict now, __global ushort *restrict before,
                     int free_bits, int block_rows, int block_columns) {
    const int parts = get_global_size(1) / 2, part = get_global_id(1) % parts;
    const bool of_frame = get_global_id(1) < parts;
    __global ushort *plane = of_frame ? now : before;
    int2 size = size_of(0, block_rows, block_columns);
    int row = part * DEEPEST, end = min(row + DEEPEST, size.x);
    int first = get_global_id(0) * STRIP * UNITS_ACROSS, last = min(first + STRIP * UNITS_ACROSS, size.y);
    for (int y = row; of_frame && y < end; y++) {
        means(raw, plane, y, first, last, free_bits, size.y);
        fill_beside(plane, y, size.x, size.y, first, last);
    }
    for (int level = 1; level < PLANES; level++) {
        const int wide = size.y;
        __global ushort *coarse = plane + (size.x + 2 * MARGIN) * row_length(wide);
        size >>= 1;
        row >>= 1, end = min(end >> 1, size.x), first >>= 1, last >>= 1;
        for (int y = row; y < end; y++) {
            halve(plane, coarse, y, first, last, wide, size.y);
            fill_beside(coarse, y, size.x, size.y, first, last);
        }
        plane = coarse;
    }
}

// Windows of a block in the frame and in the history.
typedef struct {
    __global const ushort *now, *before;  // first sample of the window in the frame, and in the history without motion
    int2 window;                          // rows and columns of the window
    int length;                           // row length of the planes
#if LANES > 1
    const ushort *tiles, *most;  // window values tile by tile, and the limits of differences, which are zero outside the window
#endif
} Search;

#if LANES == 1
// Sums the values in the window.
INLINE int light_in(const Search *s) {
    int sum = 0;
    for (int y = 0; y < s->window.x; y++)
        for (int x = 0; x < s->window.y; x++) sum += s->now[y * s->length + x];
    return sum;
}

// Returns the sum of absolute differences, each limited to MOST_DIFFERENCE. Stops early once the sum reaches `limit`.
INLINE int cost(const Search *s, int2 vector, int limit) {
    __global const ushort *now = s->now, *before = s->before + vector.x * s->length + vector.y;
    int sum = 0;
    for (int y = 0; y < s->window.x && sum < limit; y++, now += s->length, before += s->length)
        for (int x = 0; x < s->window.y; x++) sum += min(abs_diff((int)now[x], (int)before[x]), (uint)MOST_DIFFERENCE);
    return sum;
}
#else
// Windows are read in tiles of TILE_ROWS = 4 rows and 8 columns: 32 values of 16 bits fill an AVX-512 register.
#define TILE_COLUMNS 8
#define TILE (TILE_ROWS * TILE_COLUMNS)
#define MOST_SIDE 16  // maximum side of a window
VECTOR(ushort, sixteen_shorts, 16);
VECTOR(ushort, tile_shorts, TILE);
VECTOR(int, tile_ints, TILE);
VECTOR(int, sixteen_ints, 16);

INLINE tile_shorts tile_at(__global const ushort *p, int length) {
    const eight_shorts a = LOAD_GLOBAL(eight_shorts, p), b = LOAD_GLOBAL(eight_shorts, p + length);
    const eight_shorts c = LOAD_GLOBAL(eight_shorts, p + 2 * length), d = LOAD_GLOBAL(eight_shorts, p + 3 * length);
    const sixteen_shorts above = __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const sixteen_shorts below = __builtin_shufflevector(c, d, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    return __builtin_shufflevector(above, below, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21,
                                   22, 23, 24, 25, 26, 27, 28, 29, 30, 31);
}

INLINE int sum_of(eight_ints sums) {
    const four_ints four = sums.lo + sums.hi;
    const two_ints two = four.lo + four.hi;
    return two.x + two.y;
}

INLINE void fill_most(ushort *most, int2 window) {
    for (int x = 0; x < window.y; x += TILE_COLUMNS)
        for (int y = 0; y < window.x; y += TILE_ROWS, most += TILE)
            for (int i = 0; i < TILE; i++) {
                const bool within = y + i / TILE_COLUMNS < window.x && x + i % TILE_COLUMNS < window.y;
                most[i] = within ? MOST_DIFFERENCE : 0;
            }
}

// Reads the tiles of the window, and returns the sum of its values.
INLINE int fill_tiles(const Search *s, ushort *tiles) {
    const ushort *most = s->most;
    eight_ints light = 0;
    for (int x = 0; x < s->window.y; x += TILE_COLUMNS)
        for (int y = 0; y < s->window.x; y += TILE_ROWS, tiles += TILE, most += TILE) {
            const tile_shorts tile = tile_at(s->now + y * s->length + x, s->length), none = 0;
            const tile_shorts within = SAME_BITS(LOAD_PRIVATE(tile_shorts, most) != none, tile_shorts);
            STORE_PRIVATE(tile_shorts, tiles) = tile;
            const tile_ints values = CONVERT(tile & within, tile_ints);
            const sixteen_ints sixteen = values.lo + values.hi;
            light += sixteen.lo + sixteen.hi;
        }
    return sum_of(light);
}

// Returns the sum of absolute differences, each limited to MOST_DIFFERENCE.
INLINE int cost(const Search *s, int2 vector, int limit) {
    __global const ushort *before = s->before + vector.x * s->length + vector.y;
    const ushort *now = s->tiles, *most = s->most;
    eight_ints sums = 0;
    for (int x = 0; x < s->window.y; x += TILE_COLUMNS) {
        tile_shorts columns = 0;  // these sums fit into 16 bits, because a window has at most 16 rows
        for (int y = 0; y < s->window.x; y += TILE_ROWS, now += TILE, most += TILE) {
            const tile_shorts a = LOAD_PRIVATE(tile_shorts, now), b = tile_at(before + y * s->length + x, s->length);
            const tile_shorts difference = (a > b ? a : b) - (a < b ? a : b), limits = LOAD_PRIVATE(tile_shorts, most);
            columns += difference < limits ? difference : limits;
        }
        const sixteen_shorts sixteen = columns.lo + columns.hi;
        sums += CONVERT(sixteen.lo + sixteen.hi, eight_ints);
    }
    return sum_of(sums);
}
#endif

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

// Finds the motion vector of every block at one level of the pyramid, in samples of this level. The search starts from the vectors of the next
// coarser level. `root` is 16 times the square root of the number of samples in a window.
__kernel void search(__global const ushort *restrict now, __global const ushort *restrict before,
                     __global const int2 *restrict parents, __global int2 *restrict vectors,
                     __global const int *restrict spread, int level, int window_rows, int window_columns, int root,
                     int block_rows, int block_columns) {
    const int row = get_global_id(1), begin = get_global_id(0) * STRIP, last = min(begin + STRIP, block_columns);
    const int2 period = (int2)(PERIOD_ROWS, PERIOD_COLUMNS), unit = period << level;
    const int2 block = (int2)(BLOCK_ROWS, BLOCK_COLUMNS), frame = (int2)(block_rows, block_columns) * block;
    const int2 window = (int2)(window_rows, window_columns);
    const int length = row_length(size_of(level, block_rows, block_columns).y);
    const int plane = begin_of(level, block_rows, block_columns);
    const bool coarsest = level == PLANES - 1;
#if LANES > 1
    ushort tiles[MOST_SIDE * MOST_SIDE], most_of_tiles[MOST_SIDE * MOST_SIDE];
    fill_most(most_of_tiles, window);
#endif
    for (int column = begin; column < last; column++) {
        const int2 corner = (int2)(row, column) * block, least = -(corner / unit), most = (frame - block - corner) / unit;
        const int2 first = corner / unit - (window - block / unit) / 2 + MARGIN;
        const int from = plane + first.x * length + first.y;
#if LANES == 1
        const Search s = {now + from, before + from, window, length};
        const int light = light_in(&s);
#else
        const Search s = {now + from, before + from, window, length, tiles, most_of_tiles};
        const int light = fill_tiles(&s, tiles);
#endif
        const int noise = spread[light / (window.x * window.y) >> 8];
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
