// Class feature direction (l3cli/classes/direction.py).

INLINE uints direction_of(const ints *sum, uints level, __global const int *constants) {
    ints size[4];
    #pragma unroll
    for (int k = 0; k < 4; k++) size[k] = (sum[k] < 0 ? -sum[k] : sum[k]) * (k % 2 ? DIRECTION_DIAGONAL : DIRECTION_STRAIGHT);
    ints largest = size[0], across = size[2], after = size[1], before = size[3];
    uints steepest = 0;
    #pragma unroll
    for (int k = 1; k < 4; k++) {
        const ints larger = size[k] > largest;
        across = larger ? size[(k + 2) % 4] : across;
        after = larger ? size[(k + 1) % 4] : after;
        before = larger ? size[(k + 3) % 4] : before;
        largest = larger ? size[k] : largest;
        steepest = larger ? (uints)k : steepest;
    }
    uints strength = 0;
    for (int s = 0; s < DIRECTION_STRENGTHS; s++) {
        __global const int *edges = constants + DIRECTION_HEAD + s * LEVELS;
        ints edge = edges[0];
        #pragma unroll 4
        for (int l = 1; l < LEVELS; l++) edge = level == (uints)l ? (ints)edges[l] : edge;
        strength = largest > edge ? strength + 1 : strength;
    }
    uints group = strength - 1;
#if DIRECTION_COHERENCE
    group = across * DIRECTION_SHARES <= largest * DIRECTION_COHERENCE ? 2 * group + 1 : 2 * group;
#endif
#if DIRECTION_ORIENTATIONS == 8
    steepest = after > before ? 2 * steepest + 1 : 2 * steepest;
#endif
    const uints direction = 1 + group * DIRECTION_ORIENTATIONS + steepest;
    return strength > 0 ? direction : (uints)0;
}
