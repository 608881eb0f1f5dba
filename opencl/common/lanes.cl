// Default of LANES, the number of pixels per vector, which fill a register of the target processor. PoCL 3.0 may compile for an older
// processor than the actual one, and 16 lanes would be slower than 8 if registers have 8 lanes.

#ifndef LANES
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#endif
