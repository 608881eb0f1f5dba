// Level: the formula of l3cli/classes/level.py.

#define LEVEL_CONSTANTS __global const int *restrict level_tops  // (level edge) highest level sum below each

// A channel's term of the level sum; `scaled` is its mean times 65536.
INLINE uints level_part(uints scaled) { return scaled >> (16 - LEVEL_FRACTION); }

// Whether a level sum is above `top`, the highest sum below an edge. Level sums are below 2^31, so they are compared as signed integers,
// which takes a single instruction on every processor.
INLINE ints above_level(uints level_sum, int top) {
    const ints below = top;
    return SAME_BITS(level_sum, ints) > below;
}
