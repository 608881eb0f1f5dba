// Padded mosaic and classes → outputs: the transform of each pixel's class applied to its neighbourhood.
//
// One work-item renders `strip` columns of one row. Taps of one row of the patch lie side by side in a vector of LANES;
// weights are zero in the lanes that PATCH leaves over. Row 0 of a class holds its intercept in lane 0; sums begin there.

#define CLASS_STRIDE ((PATCH + 1) * OUTPUTS * LANES)

__kernel void transform(__global const float *restrict mosaic,        // (padded row, stride) DN above black
                        __global const uint *restrict labels,         // (row, col)
                        __global const float *restrict weights,       // (class, 1 + patch row, output, lane) per DN
                        __global float *restrict planes,              // (output, row, col)
                        int columns, int stride, ulong plane, int strip) {
    const int first = get_global_id(0) * strip, last = min(first + strip, columns);
    const size_t y = get_global_id(1);
    __global const float *patch = mosaic + y * stride;
    __global const uint *label = labels + y * columns;
    __global float *output = planes + y * columns;
    for (int x = first; x < last; x++) {
        __global const float *row = weights + (size_t)label[x] * CLASS_STRIDE;
        taps total[OUTPUTS];
        #pragma unroll
        for (int o = 0; o < OUTPUTS; o++) total[o] = *(__global const taps_unaligned *)(row + o * LANES);
        #pragma unroll
        for (int j = 0; j < PATCH; j++) {
            const taps signal = *(__global const taps_unaligned *)(patch + j * stride + x);
            row += OUTPUTS * LANES;
            #pragma unroll
            for (int o = 0; o < OUTPUTS; o++) total[o] += signal * *(__global const taps_unaligned *)(row + o * LANES);
        }
        #pragma unroll
        for (int o = 0; o < OUTPUTS; o++) output[o * plane + x] = sum_taps(total[o]);
    }
}
