// Default of LANES, the number of pixels in a vector: as many as fit a register of the processor for which the program is compiled. PoCL
// 3.0 may compile for an older processor than the actual processor. Vectors of 16 lanes in registers for 8 lanes are slower than 8 lanes.

#ifndef LANES
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#endif
