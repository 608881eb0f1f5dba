// Types that the rest is written in. The processor variant takes LANES pixels, or taps, side by side: 16 fill a register of
// AVX-512, 8 one of AVX2. The graphics variant takes one: there the device itself lays pixels side by side.
//
// vloadN and convert_T are function calls in PoCL 3.0. Reading through a pointer to a vector type that promises only the
// alignment of one element, and clang's own conversion, compile to one instruction each.

#define INLINE static inline __attribute__((always_inline))

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
VECTOR(short, signed_shorts, LANES);
VECTOR(ushort, shorts, LANES);           // as many as there are uints: half a register
VECTOR(ushort, full_shorts, 2 * LANES);  // a whole register

#define CONVERT(value, type) __builtin_convertvector(value, type)
#define SAME_BITS(value, type) __builtin_astype(value, type)

// The vector of a type that starts at p: read, or on the left of an assignment written.
#define LOAD_PRIVATE(type, p) (*(const type##_unaligned *)(p))
#define STORE_PRIVATE(type, p) (*(type##_unaligned *)(p))
#define LOAD_GLOBAL(type, p) (*(__global const type##_unaligned *)(p))
#define STORE_GLOBAL(type, p) (*(__global type##_unaligned *)(p))
#endif

// What a layer reads and sums up: values of a mosaic, or planes, in floating point or, so that planes are the same on every
// device, as whole numbers: DN in 32 bits, planes in a type that holds 53, which a double does without rounding.
#if defined(FIXED_POINT) && SOURCES > 1
#define TAP EXACT
#elif defined(FIXED_POINT)
#define TAP int
#else
#define TAP float
#endif
typedef TAP tap;
#if LANES == 1
#define JOINED(a, b) a##b
#define JOIN_NAMES(a, b) JOINED(a, b)
typedef JOIN_NAMES(TAP, 4) tap4;
#else
VECTOR(tap, taps, LANES);
VECTOR(tap, four_taps, 4);
#endif
