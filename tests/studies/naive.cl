// A yardstick and no backend: what is written first by whoever has labels and transforms of one layer. A work-item a pixel reads
// its patch and its class's weights from global memory, output after output, tap after tap (tests/studies/test_speed_study.py).

__kernel void naive(__global const ushort *raw,         // (row, col) DN
                    __global const int *row_source,     // (padded row) the raw one that it repeats
                    __global const int *column_source,  // (padded col)
                    __global const uint *labels,        // (row, col) class
                    __global const float *weights,      // (class, output, patch row, patch col) per DN above black
                    __global const float *intercept,    // (class, output)
                    __global float *outputs,            // (output, row, col)
                    float black_level, int rows, int columns) {
    const int x = get_global_id(0), y = get_global_id(1);
    const size_t at = (size_t)y * columns + x;
    for (int o = 0; o < OUTPUTS; o++) {
        const size_t row_of_table = (size_t)labels[at] * OUTPUTS + o;
        float sum = intercept[row_of_table];
        for (int i = 0; i < PATCH; i++)
            for (int j = 0; j < PATCH; j++)
                sum += weights[(row_of_table * PATCH + i) * PATCH + j]
                    * (raw[(size_t)row_source[y + i] * columns + column_source[x + j]] - black_level);
        outputs[(size_t)o * rows * columns + at] = sum;
    }
}
