// Vectors of 16 for pixels side by side, vectors of LANES (the next power of two above PATCH) for the taps of a patch row.
//
// vloadN and convert_T are function calls in PoCL 3.0. Reading through a pointer to a vector type that promises only the
// alignment of one element, and clang's own conversion, compile to one instruction each.

typedef ushort ushort16_unaligned __attribute__((ext_vector_type(16), aligned(2)));
typedef uint uint16_unaligned __attribute__((ext_vector_type(16), aligned(4)));
typedef float float16_unaligned __attribute__((ext_vector_type(16), aligned(4)));
typedef float taps_unaligned __attribute__((ext_vector_type(LANES), aligned(4)));
typedef float taps __attribute__((ext_vector_type(LANES)));

#define INLINE static inline __attribute__((always_inline))

INLINE float sum4(float4 v) { return (v.x + v.z) + (v.y + v.w); }
#if LANES == 4
INLINE float sum_taps(taps v) { return sum4(v); }
#elif LANES == 8
INLINE float sum_taps(taps v) { return sum4(v.lo + v.hi); }
#else
INLINE float sum_taps(taps v) { float8 half_sum = v.lo + v.hi; return sum4(half_sum.lo + half_sum.hi); }
#endif
