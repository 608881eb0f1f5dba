// Raw values → padded mosaic, as integers for the classes and above black for the transforms.
//
// One work-item writes `strip` columns of one padded row. row_source and column_source name the raw row and column that
// each padded one repeats (frame.mirrored_indices; the slack columns behind the right margin repeat any), so that padding
// never breaks the phase of the CFA. The black level is taken off here: zero signal then stays zero in every transform.

__kernel void ingest(__global const ushort *restrict raw,            // (row, col) DN
                     __global const int *restrict row_source,        // (padded row)
                     __global const int *restrict column_source,     // (stride)
                     __global ushort *restrict padded,               // (padded row, stride) DN
                     __global float *restrict mosaic,                // (padded row, stride) DN above black
                     int columns, int stride, float black, int strip) {
    const int first = get_global_id(0) * strip, last = min(first + strip, stride);
    const size_t y = get_global_id(1);
    __global const ushort *from = raw + (size_t)row_source[y] * columns;
    __global ushort *to = padded + y * stride;
    __global float *signal = mosaic + y * stride;
    for (int x = first; x < last; x++) {
        const int inside = x - RADIUS;
        to[x] = from[inside >= 0 && inside < columns ? inside : column_source[x]];
    }
    for (int x = first; x < last; x++) signal[x] = to[x] - black;
}
