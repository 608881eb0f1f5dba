// Class feature saturation case (l3cli/classes/saturation.py).

#define SATURATION_CONSTANTS __global const ushort *restrict case_of_code  // (code)

#if LANES == 1
typedef uint patterns;  // set of saturated channels, one bit per channel
INLINE uint case_of(patterns code, __global const ushort *case_of_code) { return case_of_code[code]; }
INLINE bool any_case(patterns code, __global const ushort *case_of_code) { return true; }
#else
typedef shorts patterns;

// Look up which channels clip around LANES pixels (their saturation cases), one by one.
INLINE uints case_of(patterns code, __global const ushort *case_of_code) {
    uint saturation[LANES];
    ushort pattern[LANES];
    STORE_PRIVATE(shorts, pattern) = code;
    #pragma clang loop vectorize(disable) unroll(disable)
    for (int i = 0; i < LANES; i++) saturation[i] = case_of_code[pattern[i]];
    return LOAD_PRIVATE(uints, saturation);
}

// Return whether any of LANES pixels may have clipped channels in its patch (a saturation case other than 0). This is rare,
// so the slow lookup is usually skipped.
INLINE bool any_case(patterns code, __global const ushort *case_of_code) {
    ulong word[LANES / 4], all = 0;
    *(shorts_unaligned *)word = code;
    #pragma unroll
    for (int i = 0; i < LANES / 4; i++) all |= word[i];
    return all != 0 || case_of_code[0];
}
#endif
