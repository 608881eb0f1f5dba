// Number of pixels side by side, unless the host sets it: as many as fit a register of the processor that is compiled for. PoCL 3.0
// may compile for an older processor than the actual one, and 16 lanes in registers of 8 are slower than 8 lanes.

#ifndef LANES
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#endif
