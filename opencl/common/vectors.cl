// Vector types of all kernels. The processor variant processes LANES pixels, or taps, side by side: 16 fill a register of AVX-512,
// 8 a register of AVX2. The graphics variant processes one, because the device itself runs pixels side by side.
//
// vloadN and convert_T are function calls in PoCL 3.0. Instead, vectors are read through pointers to a type with the alignment of a
// single element, and converted by clang's own conversion. Each compiles to one instruction.

#define INLINE static inline __attribute__((always_inline))

#define GAIN_NODES(columns) (((columns) + GAIN_STEP - 1) / GAIN_STEP + 1)  // nodes in a row of gains (l3cli/frames/shading.py)

#if LANES == 1
typedef uint uints;
typedef int ints;
typedef float floats;
#define CONVERT(value, type) ((type)(value))
#define SAME_BITS(value, type) as_##type(value)
#define as_uints as_uint
#define as_ints as_int
#define as_floats as_float
#else
#define VECTOR(element, name, lanes) \
    typedef element name __attribute__((ext_vector_type(lanes))); \
    typedef element name##_unaligned __attribute__((ext_vector_type(lanes), aligned(sizeof(element))))
VECTOR(uint, uints, LANES);
VECTOR(int, ints, LANES);
VECTOR(float, floats, LANES);
VECTOR(char, signed_chars, LANES);
VECTOR(uchar, bytes, LANES);
VECTOR(short, signed_shorts, LANES);
VECTOR(ushort, shorts, LANES);           // as many as there are uints: half a register
VECTOR(ushort, full_shorts, 2 * LANES);  // a whole register
VECTOR(short, pairs, 2 * LANES);

#if LANES == 16
#define ALL_LANES(index) index(0), index(1), index(2), index(3), index(4), index(5), index(6), index(7), \
    index(8), index(9), index(10), index(11), index(12), index(13), index(14), index(15)
#else
#define ALL_LANES(index) index(0), index(1), index(2), index(3), index(4), index(5), index(6), index(7)
#endif

#define EVEN(i) (2 * (i))
#define ODD(i) (2 * (i) + 1)

#define CONVERT(value, type) __builtin_convertvector(value, type)
#define SAME_BITS(value, type) __builtin_astype(value, type)

// The vector of a type that starts at p, for reading and for assignment.
#define LOAD_PRIVATE(type, p) (*(const type##_unaligned *)(p))
#define STORE_PRIVATE(type, p) (*(type##_unaligned *)(p))
#define LOAD_GLOBAL(type, p) (*(__global const type##_unaligned *)(p))
#define STORE_GLOBAL(type, p) (*(__global type##_unaligned *)(p))

// Kernels with one work-item per group only call a function that does the work. PoCL compiles each kernel three times, once as it is
// and twice in the code that starts work-groups, but the function only once.
#define COMPILED_ONCE static __attribute__((noinline)) void
#define KERNEL_OF_ONE __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void
#define GROUP_COLUMN ((int)get_group_id(0) * TILE)  // first column of the tile
#define GROUP_ROW ((int)get_group_id(1) * BAND)

// A loop over the few pixels at an edge that do not fill a vector. Vectorising and unrolling, which the compiler would do, are
// switched off, because the code rarely runs and would take time to compile.
#define AT_EDGE _Pragma("clang loop vectorize(disable) unroll(disable)")

// The first `count` lanes of a vector → to[0], to[1] …, through an array, because selecting a lane by a variable takes much code.
#define WRITE_FIRST(element, type, to, value, count) do { \
    element lane[LANES]; \
    STORE_PRIVATE(type, lane) = value; \
    AT_EDGE for (int i = 0; i < (count); i++) (to)[i] = lane[i]; \
} while (0)
#define STORE_FIRST(to, value, count) do { \
    if ((count) >= LANES) STORE_GLOBAL(floats, to) = value; \
    else WRITE_FIRST(float, floats, to, value, count); \
} while (0)

// Prefetch the cache line at p, which is read one row later. Processors do not predict where the next row of a tile lies. One line is
// prefetched per LANES pixels, while others are computed, because many prefetches at once would queue.
#ifdef __NVPTX__ // NVIDIA's compiler refuses the address space, and graphics cards hide the latency themselves
#define FETCH(p)
#else
#define FETCH(p) __builtin_prefetch((const void *)(size_t)(p))
#endif

// Products of 16-bit pairs, added to each other and to `sum`. It is a single instruction if the compiler supports it.
INLINE ints add_pairs(ints sum, pairs a, pairs b) {
#if LANES == 16 && defined(__AVX512BW__)
    return sum + SAME_BITS(__builtin_ia32_pmaddwd512(a, b), ints);
#elif LANES == 8 && defined(__AVX2__)
    return sum + SAME_BITS(__builtin_ia32_pmaddwd256(a, b), ints);
#else
#define HALF_OF(v, place) CONVERT(__builtin_shufflevector(v, v, ALL_LANES(place)), ints)
    return sum + HALF_OF(a, EVEN) * HALF_OF(b, EVEN) + HALF_OF(a, ODD) * HALF_OF(b, ODD);
#endif
}
#endif

// Types of a layer's values and sums. The last layer reads the mosaic or planes in floating point. Other layers use 16-bit integers
// with 32-bit sums, two products per lane, so that planes are the same on every device.
#if LANES == 1
#ifdef FIXED_POINT
typedef int tap;
typedef int4 tap4;
#else
typedef float tap;
typedef float4 tap4;
#endif
#elif defined(FIXED_POINT)
#define TAP_LANES (2 * LANES)
typedef short tap;
typedef int total;
VECTOR(int, totals, LANES);
VECTOR(short, taps, TAP_LANES);
VECTOR(int, four_totals, 4);

INLINE totals add_products(totals sum, taps a, taps b) { return add_pairs(sum, a, b); }
#else
#define TAP_LANES LANES
typedef float tap;
typedef float total;
VECTOR(float, totals, LANES);
VECTOR(float, taps, TAP_LANES);
VECTOR(float, four_totals, 4);

INLINE totals add_products(totals sum, taps a, taps b) { return sum + a * b; }
#endif
