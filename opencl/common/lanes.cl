// Default of LANES, the number of pixels per vector. A vector fills a register of the target processor. PoCL 3.0 may compile for an older
// processor than the actual one. If the registers have 8 lanes, vectors of 16 lanes would be slower than vectors of 8.

#ifndef LANES
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#endif
