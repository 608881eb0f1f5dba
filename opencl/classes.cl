// Processor variant: raw frame → class of every pixel.
//
// One work-item labels a tile of TILE columns and BAND rows, row after row.

#ifndef TRANSFORM_ONLY  // a program beside one that has this kernel already
__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void classes(__global const ushort *restrict raw,                // (row, col) DN
             __global const int *restrict row_source,            // (padded row)
             __global const int *restrict column_source,         // (padded col)
             __global const ushort *restrict member,             // (channel, CFA row, period) all bits or none
             __global const ushort *restrict channel_bit,        // (CFA row, period) 1 << channel
             __global const uint *restrict count,                // (channel, CFA row, period) taps of the channel
             __global const uint *restrict mean_reciprocal,      // (channel, CFA row, period) round(65536 / count)
             __global const uint *restrict variance_reciprocal,  // (channel, CFA row, period) round(512 / count)
             __global const uint *restrict site_column,          // (period) CFA column
             RULE_CONSTANTS,
             __global uint *restrict labels,                     // (row, col)
             int phase_row, int phase_column, int rows, int columns) {
    const int x0 = get_group_id(0) * TILE, y0 = get_group_id(1) * BAND;
    const int y1 = min(y0 + BAND, rows), width = min(TILE, columns - x0);
    const int span = WHOLE(WHOLE(width, LANES) + 2 * RADIUS, 2 * LANES);
    const int padded_phase = PADDED_PHASE(x0, phase_column, CFA_COLUMNS), first_phase = (x0 + phase_column) % CFA_COLUMNS;
    ushort ring[PATCH + 1][SPAN];  // the latest rows, padded row k - y0 in slot (k - y0) % (PATCH + 1)
    Columns near;
    Runs runs;
#ifdef BOX_ROWS
    box boxes[PATCH + 1][SPAN];  // sums over boxes by their last row, in its slot
#endif
    for (int i = 0; i < (PATCH + 1) * SPAN; i++) ring[0][i] = 0;
    for (int i = 0; i < CHANNELS * SPAN; i++) near.sum[0][i] = 0;
    for (int i = 0; i < CHANNELS * SPAN; i++) near.square[0][i] = 0;
    for (int i = 0; i < SPREAD * SPAN; i++) near.saturated[0][i] = 0;
    for (int i = 0; i < CHANNELS * SPAN; i++) runs.sum[0][i] = runs.square[0][i] = 0;
    for (int k = 0; k < y1 - y0 + 2 * RADIUS; k++) {
        // The slot after the newest holds the row that leaves; while the first patch fills it holds zeros.
        ushort *entering = ring[k % (PATCH + 1)], *leaving = ring[(k + 1) % (PATCH + 1)];
        ingest(entering, raw + (size_t)row_source[y0 + k] * columns, column_source, x0, columns);
        const int row_phase = PADDED_PHASE(y0 + k, phase_row, CFA_ROWS);
        const int leaving_phase = PADDED_PHASE(y0 + k + (CFA_ROWS - 1) * PATCH, phase_row, CFA_ROWS);
        slide(&near, entering, member + row_phase * PERIOD, leaving, member + leaving_phase * PERIOD, padded_phase, span);
#ifdef BOX_ROWS
        add_boxes(boxes[k % (PATCH + 1)], ring, k % (PATCH + 1), span);
#endif
        const int late = k - (RADIUS - SATURATION_RADIUS);  // saturation counts in fewer rows: the lowest came earlier
        if (late >= 0)
            saturated_row(near.saturated[late % SPREAD], ring[late % (PATCH + 1)],
                          channel_bit + PADDED_PHASE(y0 + late, phase_row, CFA_ROWS) * PERIOD, padded_phase, span);
        if (k < 2 * RADIUS) continue;
        const int y = y0 + k - 2 * RADIUS, site_row = (y + phase_row) % CFA_ROWS;
        add_runs(&runs, &near, span);
        __global uint *label_row = labels + (size_t)y * columns + x0;
        __global const ushort *next = raw + (size_t)row_source[min(y0 + k + 1, y1 + 2 * RADIUS - 1)] * columns + x0;
        for (int x = 0, phase = first_phase; x < width; x += LANES, phase = PHASE_AFTER(phase, LANES)) {
            FETCH(next + x);
            Evidence evidence;
            no_evidence(&evidence, RULE);
            #pragma unroll
            for (int c = 0; c < CHANNELS; c++) {
                const int at = (c * CFA_ROWS + site_row) * PERIOD + phase;
                add_evidence(&evidence, c, LOAD_GLOBAL(uints, count + at), patch_sum(&runs, &near, c, x),
                             patch_square(&runs, &near, c, x), LOAD_GLOBAL(uints, mean_reciprocal + at),
                             LOAD_GLOBAL(uints, variance_reciprocal + at), RULE);
            }
#ifdef BOX_ROWS
#define ADD_WINDOW(s, top, left, rows, columns, sign) \
    evidence.window_sum[s] = evidence.window_sum[s] sign LOAD_BOX(boxes[(k - 2 * RADIUS + top + rows - 1) % (PATCH + 1)] + x + left);
            EACH_WINDOW(ADD_WINDOW)
#elif defined(EACH_WINDOW)
#define ADD_WINDOW(s, top, left, rows, columns, sign) \
    evidence.window_sum[s] = evidence.window_sum[s] sign window_sum(ring, k - 2 * RADIUS, top, left, rows, columns, x);
            EACH_WINDOW(ADD_WINDOW)
#endif
            const shorts code = patch_saturated(&runs, x);
            const uints site = LOAD_GLOBAL(uints, site_column + phase) + site_row * CFA_COLUMNS;
            const uints label = class_of(&evidence, site, code, RULE);
            if (x + LANES <= width) STORE_GLOBAL(uints, label_row + x) = label;
            else for (int i = 0; x + i < width; i++) label_row[x + i] = label[i];
        }
    }
}
#endif
