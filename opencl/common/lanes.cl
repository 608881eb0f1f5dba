// Where the host does not say how many pixels lie side by side: as many as the compiler has registers for. PoCL 3.0 takes
// processors younger than itself for older ones, and 16 lanes in registers of 8 are slower than 8 lanes.

#ifndef LANES
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#endif
