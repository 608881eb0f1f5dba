// Temporal filter: types and functions for temporal_motion.cl and temporal_blend.cl. These kernels blend a mosaic with the history, which is the
// filtered previous mosaic. The reference is l3cli/rendering/temporal/reference.py.
//
// All computations are exact, so that all devices have the same results. Each work-item processes STRIP adjacent blocks. Frames are padded to a
// whole number of blocks and are `columns` wide. Values are integers u = DN << free_bits, which use at most 16 bits.

#define CELL_ROWS (BLOCK_ROWS / CELL_DOWN)
#define CELL_COLUMNS (BLOCK_COLUMNS / CELL_ACROSS)
#define SITES (CELL_ROWS * CELL_COLUMNS)
#define PERIOD_SITES (PERIOD_ROWS * PERIOD_COLUMNS)
#define UNITS_DOWN (BLOCK_ROWS / PERIOD_ROWS)  // CFA periods per block along each axis; each is a sample of the finest plane
#define UNITS_ACROSS (BLOCK_COLUMNS / PERIOD_COLUMNS)

// Vectors contain CELL_LANES cells. Sums over cells exceed 32 bits, so the vectors contain doubles. Doubles represent integers up to 2^53
// exactly, and vectors of doubles can be divided.
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
#define FETCH_NEXT(p)
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
#define ALL_IF(condition) (condition)  // all bits set in the lanes in which the condition is true
#define TRUE_CELLS(condition) CONVERT(condition, cell_ints)  // like ALL_IF, for conditions on doubles
#define FLOOR(value) CONVERT(value, cell_ints)  // for non-negative values
#define FETCH_NEXT(p) FETCH(p)

// Mask with all bits set in the first `count` lanes.
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

// Converts DN to u, which has `free_bits` fractional bits of a DN.
INLINE ints units(ints value, int free_bits) { return least_of(value, (1 << (16 - free_bits)) - 1) << free_bits; }
