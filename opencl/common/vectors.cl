// Vector types of all kernels. In the processor variant, a vector contains LANES pixels or taps: 16 lanes fill an AVX-512 register, and 8
// lanes fill an AVX2 register. In the graphics variant, LANES is 1, because the device itself processes many pixels in parallel.
//
// In PoCL 3.0, vloadN and convert_T are function calls. Vectors are therefore read through pointers to a type with the alignment of a single
// element, and converted with a clang builtin. Each of these operations compiles to one instruction.

#define INLINE static inline __attribute__((always_inline))

#define GAIN_NODES(columns) (((columns) + GAIN_STEP - 1) / GAIN_STEP + 1)  // nodes per row of shading gains (l3cli/frames/shading.py)

#if LANES == 1
typedef uint uints;
typedef int ints;
typedef float floats;
#define CONVERT(value, type) ((type)(value))
#define SAME_BITS(value, type) as_##type(value)
#define as_uints as_uint
#define as_ints as_int
#define as_floats as_float

INLINE bool any_lane(ints mask) { return mask != 0; }
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
VECTOR(ushort, shorts, LANES);           // half a register
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

// Returns whether a comparison is true for any lane.
INLINE bool any_lane(ints mask) {
#if LANES == 16
    typedef int eight __attribute__((ext_vector_type(8)));
    const eight some = mask.lo | mask.hi;
#else
    const ints some = mask;
#endif
    const int4 four = some.lo | some.hi;
    return (four.x | four.y | four.z | four.w) != 0;
}

// The vector that starts at p. LOAD macros read it, and STORE macros write it.
#define LOAD_PRIVATE(type, p) (*(const type##_unaligned *)(p))
#define STORE_PRIVATE(type, p) (*(type##_unaligned *)(p))
#define LOAD_GLOBAL(type, p) (*(__global const type##_unaligned *)(p))
#define STORE_GLOBAL(type, p) (*(__global type##_unaligned *)(p))

// A kernel with one work-item per group only calls a function that does the work. PoCL compiles each kernel three times (once as written, and
// twice in the code that starts work-groups), but compiles the function only once.
#define COMPILED_ONCE static __attribute__((noinline)) void
#define KERNEL_OF_ONE __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void
#define GROUP_COLUMN ((int)get_group_id(0) * TILE)  // first column of the tile
#define GROUP_ROW ((int)get_group_id(1) * BAND)

// Marks a loop over the few edge pixels that do not fill a vector. It is neither vectorised nor unrolled, to save compilation time for code
// that rarely runs.
#define AT_EDGE _Pragma("clang loop vectorize(disable) unroll(disable)")

// Writes the first `count` lanes of a vector to to[0], to[1] …. The lanes are first copied to an array, because compilers generate a lot of
// code for selecting a lane by a variable.
#define WRITE_FIRST(element, type, to, value, count) do { \
    element lane[LANES]; \
    STORE_PRIVATE(type, lane) = value; \
    AT_EDGE for (int i = 0; i < (count); i++) (to)[i] = lane[i]; \
} while (0)
#define STORE_FIRST(to, value, count) do { \
    if ((count) >= LANES) STORE_GLOBAL(floats, to) = value; \
    else WRITE_FIRST(float, floats, to, value, count); \
} while (0)

// Prefetches the cache line at p, which is needed for the next row. Processors do not predict where the next row of a tile begins. One line
// is prefetched per LANES pixels, because many simultaneous prefetches would delay one another.
#ifdef __NVPTX__ // NVIDIA's compiler rejects the address space, and GPUs hide the latency themselves
#define FETCH(p)
#else
#define FETCH(p) __builtin_prefetch((const void *)(size_t)(p))
#endif

// Multiplies 16-bit values, and adds the two products of each pair to `sum`, with a single multiply instruction on most processors.
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

// Types of a layer's values and sums. The last layer uses floating point. All other layers use 16-bit values and 32-bit sums (two products per
// lane), so that planes are the same on every device.
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
