// Level: the formula of l3cli/classes/level.py.

#define LEVEL_CONSTANTS __global const int *restrict level_tops  // (level edge) highest level sum below each

// What a channel adds to the level sum; `scaled` is its mean times 65536.
INLINE uints level_part(uints scaled) { return scaled >> (16 - LEVEL_FRACTION); }

// Whether a level sum lies above `top`, the highest one below an edge.
// Level sums are below 2^31: signed comparison is one instruction on every processor, unsigned is not.
INLINE ints above_level(uints level_sum, int top) {
    const ints below = top;
    return SAME_BITS(level_sum, ints) > below;
}
