// Class feature level, with the formula of l3cli/classes/level.py.

#define LEVEL_CONSTANTS __global const int *restrict level_tops  // (level edge) largest level sum below the edge

// Term of a channel in the level sum. `scaled` is the mean of the channel times 65536.
INLINE uints level_part(uints scaled) { return scaled >> (16 - LEVEL_FRACTION); }

// Whether a level sum is above `top`, the largest sum below an edge. Level sums are below 2^31. They are compared as signed integers,
// because this is a single instruction on every processor.
INLINE ints above_level(uints level_sum, int top) {
    const ints below = top;
    return SAME_BITS(level_sum, ints) > below;
}
