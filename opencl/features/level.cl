// Class feature level (l3cli/classes/level.py).

#define LEVEL_CONSTANTS __global const int *restrict level_tops  // (level edge) largest level sum below the edge

// A channel's term in the level sum. `scaled` is the channel mean times 65536.
INLINE uints level_part(uints scaled) { return scaled >> (16 - LEVEL_FRACTION); }

// Whether a level sum is above an edge. `top` is the largest sum below the edge. Sums are below 2^31, so they can be compared as signed integers.
// This takes a single instruction on every processor.
INLINE ints above_level(uints level_sum, int top) {
    const ints below = top;
    return SAME_BITS(level_sum, ints) > below;
}
