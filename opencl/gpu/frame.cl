// Graphics variant: computes classes and transforms. Each work-item processes one pixel. A work-group processes TILE × BAND pixels and copies them,
// with their neighbourhood, to local memory. For classes, local memory also contains the column sums of the patches. Weights are read from
// global memory through the caches.
//
// Adjacent work-items run together, and are fastest if they read the weights of the same class. They therefore process pixels with the same CFA
// column. TILE is a multiple of CFA_COLUMNS.

#define SPREAD (2 * SATURATION_RADIUS + 1)  // rows and columns in which saturation is tested
#define TILE_COLUMNS (TILE + 2 * RADIUS)
#define TILE_ROWS (BAND + 2 * RADIUS)
#define OF_ONE_SITE (TILE / CFA_COLUMNS)
#define ITEMS (TILE * BAND)

// Returns the tile column of the work-item with the local number i.
INLINE int column_of(int i) { return i % OF_ONE_SITE * CFA_COLUMNS + i / OF_ONE_SITE; }

// Returns the index in `raw` of padded pixel i in the tile at (y0, x0). Outside the padded frame, the index is arbitrary but valid.
INLINE size_t source_of(int i, int y0, int x0, __global const int *row_source, __global const int *column_source, int rows,
                        int columns) {
    const int row = min(y0 + i / TILE_COLUMNS, rows + 2 * RADIUS - 1);
    const int column = min(x0 + i % TILE_COLUMNS, columns + 2 * RADIUS - 1);
    return (size_t)row_source[row] * columns + column_source[column];
}

#if SOURCES == 1 && !defined(TRANSFORM_ONLY)

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void classes(__global const ushort *restrict raw,                // (row, col) DN
             __global const int *restrict row_source,            // (padded row)
             __global const int *restrict column_source,         // (padded col)
             __global const ushort *restrict member,             // (channel, CFA row, period) all bits set where a pixel has the channel
             __global const ushort *restrict channel_bit,        // (CFA row, period) 1 << channel
             __global const uint *restrict count,                // (channel, CFA row, period) number of taps of the channel
             __global const uint *restrict mean_reciprocal,      // (channel, CFA row, period) round(65536 / count)
             __global const uint *restrict variance_reciprocal,  // (channel, CFA row, period) round(512 / count)
             __global const uint *restrict site_column,          // (period) CFA column
             RULE_CONSTANTS SET_PARAMETER,
             __global uint *restrict labels,                     // (row, col)
             int phase_row, int phase_column, int rows, int columns) {
    __local ushort value[TILE_ROWS][TILE_COLUMNS], bit[TILE_ROWS][TILE_COLUMNS];  // DN and 1 << channel
    __local uint sum[BAND][TILE_COLUMNS], square[BAND][TILE_COLUMNS];             // sums over the rows of the patch, for one channel
    __local ushort saturated[BAND][TILE_COLUMNS];
    const int x0 = get_group_id(0) * TILE, y0 = get_group_id(1) * BAND;
    const int column = column_of(get_local_id(0)), line = get_local_id(1), item = line * TILE + get_local_id(0);
    const int x = x0 + column, y = y0 + line;
    for (int i = item; i < TILE_ROWS * TILE_COLUMNS; i += ITEMS) {
        const int row = i / TILE_COLUMNS, p = i % TILE_COLUMNS;
        value[row][p] = min(raw[source_of(i, y0, x0, row_source, column_source, rows, columns)], (ushort)MAX_RAW);
        bit[row][p] = channel_bit[PADDED_PHASE(y0 + row, phase_row, CFA_ROWS) * PERIOD
                                  + PADDED_PHASE(x0 + p, phase_column, CFA_COLUMNS)];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = item; i < BAND * TILE_COLUMNS; i += ITEMS) {
        const int row = i / TILE_COLUMNS, p = i % TILE_COLUMNS;
        uint channels = 0;
        for (int j = row + RADIUS - SATURATION_RADIUS; j <= row + RADIUS + SATURATION_RADIUS; j++)
            channels |= value[j][p] >= SATURATION ? bit[j][p] : 0;
        saturated[row][p] = channels;
    }
    const int site_row = (y + phase_row) % CFA_ROWS, site = (x + phase_column) % CFA_COLUMNS;
    Evidence evidence;
    no_evidence(&evidence, RULE);
    for (int c = 0; c < CHANNELS; c++) {
        for (int i = item; i < BAND * TILE_COLUMNS; i += ITEMS) {
            const int row = i / TILE_COLUMNS, p = i % TILE_COLUMNS;
            uint s = 0, q = 0;
            for (int j = row; j < row + PATCH; j++) {
                const uint v = bit[j][p] == 1u << c ? (uint)value[j][p] >> SHIFT : 0u;
                s += v;
                q += v * v;
            }
            sum[row][p] = s;
            square[row][p] = q;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        uint s = 0, q = 0;
        for (int p = column; p < column + PATCH; p++) {
            s += sum[line][p];
            q += square[line][p];
        }
        const int at = (c * CFA_ROWS + site_row) * PERIOD + site;
        add_evidence(&evidence, c, count[at], s, q, mean_reciprocal[at], variance_reciprocal[at], RULE);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
#ifdef EACH_WINDOW
#define ADD_WINDOW(s, top, left, rows, columns, sign) \
    for (int j = line + top; j < line + top + rows; j++) \
        for (int p = column + left; p < column + left + columns; p++) evidence.window_sum[s] sign##= value[j][p] >> SHIFT;
    EACH_WINDOW(ADD_WINDOW)
#endif
    uint code = 0;
    for (int p = column + RADIUS - SATURATION_RADIUS; p <= column + RADIUS + SATURATION_RADIUS; p++) code |= saturated[line][p];
    if (x >= columns || y >= rows) return;
    const size_t pixel = (size_t)y * columns + x;
    labels[pixel] = class_of(&evidence, site_row * CFA_COLUMNS + site, code, SET_AT(pixel) RULE);
}

#endif

#define FOURS ((OUTPUTS + 3) / 4)  // vectors of four outputs
#ifdef RATIO_TAPS
#define TAPS_OF_RATIOS RATIO_TAPS

INLINE float square_between(__local const tap *one, __local const tap *other) {
    float sum = 0.0f;
    for (int s = 0; s < SOURCES; s++) sum += (one[s] - other[s]) * (one[s] - other[s]);
    return sum;
}
#else
#define TAPS_OF_RATIOS 0
#endif
#define CLASS_STRIDE ((PATCH * PATCH * SOURCES + 1 + TAPS_OF_RATIOS) * FOURS)
#if SOURCES == 1
#define SOURCE ushort
#else
#define SOURCE int
#endif

#if defined(FIXED_POINT)
// The weights of a class have the format of pack_whole_in_fours (layout.py). The unused fourth output has no taps, and its intercept is the number
// of fractional bits of the class. output[3] is therefore this number.
INLINE void write(__global int *picture, const tap *output, __global const float *matrix, size_t at, size_t pixels) {
    for (int o = 0; o < OUTPUTS; o++) picture[o * pixels + at] = plane_value(output[o], output[3]);
}
#elif defined(PLANES)
INLINE void write(__global float *picture, const float *output, __global const float *matrix, size_t at, size_t pixels) {
    for (int o = 0; o < OUTPUTS; o++) picture[o * pixels + at] = output[o];
}
#elif defined(NOT_ENCODED)  // writes only the sum of three outputs, so that the time of the transforms can be measured without encoding
INLINE void write(__global float *picture, const float *output, __global const float *matrix, size_t at, size_t pixels) {
    picture[at] = output[0] + output[1] + output[2];
}
#else
INLINE void write(__global CODE *picture, const float *output, __global const float *matrix, size_t at, size_t pixels) {
    float linear[3];
    for (int p = 0; p < 3; p++)
        linear[p] = matrix[3 * p] * output[0] + matrix[3 * p + 1] * output[1] + matrix[3 * p + 2] * output[2];
    into_gamut(linear);
    for (int p = 0; p < 3; p++) picture[3 * at + p] = (CODE)encode(linear[p]);
}
#endif

__kernel __attribute__((reqd_work_group_size(TILE, BAND, 1)))
void transform(__global const SOURCE *restrict source,      // (source, row, col) the mosaic in DN, or planes
               __global const int *restrict row_source,     // (padded row)
               __global const int *restrict column_source,  // (padded col)
               __global const uint *restrict labels,        // (row, col)
               __global const tap4 *restrict weights,       // (class, intercept and taps column by column, output)
               __global const float *restrict matrix,       // (3, 3) from XYZ to linear picture values, then the XYZ of the clipped white
               __global CODE *restrict picture,             // (output, row, col), or (row, col, 3)
#ifdef SHADED
               __global const float *restrict gain,         // (row, node) shading gains of the outputs, every GAIN_STEP columns
#endif
#ifdef COARSE_CHROMA
               __global const float *restrict before,       // (plane, row, col) blocks before smoothing
               __global const float *restrict after,        // (plane, row, col) blocks after smoothing
#endif
#ifdef CLIPPING
               __global const float *restrict maps,         // maps of quads (common/quads.cl)
#endif
#ifdef CORRECTS
               __global const float *restrict corrected,    // (output, source row, col) outputs of the first layer
#endif
               float black_level, int source_rows, int rows, int columns) {
    __local tap signal[TILE_ROWS][TILE_COLUMNS][SOURCES];
    const int x0 = get_group_id(0) * TILE, y0 = get_group_id(1) * BAND;
    const int column = column_of(get_local_id(0)), line = get_local_id(1), x = x0 + column, y = y0 + line;
    for (int i = line * TILE + get_local_id(0); i < TILE_ROWS * TILE_COLUMNS; i += ITEMS) {
        const size_t place = source_of(i, y0, x0, row_source, column_source, rows, columns);
        __local tap *to = signal[i / TILE_COLUMNS][i % TILE_COLUMNS];
#if SOURCES > 1 && defined(FIXED_POINT)
        for (int s = 0; s < SOURCES; s++) to[s] = coarse(source[place + (size_t)s * source_rows * columns]);
#elif SOURCES > 1
        for (int s = 0; s < SOURCES; s++) to[s] = source[place + (size_t)s * source_rows * columns];
#elif defined(FIXED_POINT)
        to[0] = min(source[place], (ushort)MAX_RAW) - RAW_MIDDLE;
#else
        to[0] = min(source[place], (ushort)MAX_RAW) - black_level;
#endif
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (x >= columns || y >= rows) return;
    const size_t at = (size_t)y * columns + x;
    __global const tap4 *weight = weights + (size_t)labels[at] * CLASS_STRIDE;
    tap4 total[FOURS];
    for (int f = 0; f < FOURS; f++) total[f] = *weight++;
    for (int i = 0; i < PATCH; i++) {
        #pragma unroll
        for (int j = 0; j < PATCH; j++) {
            #pragma unroll
            for (int s = 0; s < SOURCES; s++) {
                const tap value = signal[line + j][column + i][s];
                #pragma unroll
                for (int f = 0; f < FOURS; f++) total[f] += value * *weight++;
            }
        }
    }
#ifdef RATIO_TAPS
    // Two taps follow the window: the chroma differences that a change in illumination alone would cause (l3cli/classes/refinement.py).
    float sum[SOURCES] = {0};
    for (int i = 0; i < PATCH; i++)
        for (int j = 0; j < PATCH; j++)
            for (int s = 0; s < SOURCES; s++) sum[s] += signal[line + j][column + i][s];
    const float count = PATCH * PATCH, luminance = signal[line + RADIUS][column + RADIUS][LUMINANCE];
    const float share = clamp((count * luminance - sum[LUMINANCE]) / max(sum[LUMINANCE], count * DARKEST), -1.0f, 1.0f) / count;
    for (int f = 0; f < FOURS; f++) total[f] += sum[0] * share * *weight++;
    for (int f = 0; f < FOURS; f++) total[f] += sum[SOURCES - 1] * share * *weight++;
#if RATIO_TAPS > 2
    // Two more taps: the mean chroma difference between similar pixels and this pixel.
    __local const tap *own = signal[line + RADIUS][column + RADIUS];
    float reach = 0.0f, weighed = 0.0f, first = 0.0f, third = 0.0f;
    for (int n = 0; n < PATCH * PATCH; n++) reach += square_between(signal[line + n % PATCH][column + n / PATCH], own);
    reach = reach / count + (float)DARKEST * DARKEST;
    for (int n = 0; n < PATCH * PATCH; n++) {
        __local const tap *there = signal[line + n % PATCH][column + n / PATCH];
        const float left = max(reach - square_between(there, own), 0.0f);
        weighed += left * left;
        first += left * left * (there[0] - own[0]);
        third += left * left * (there[SOURCES - 1] - own[SOURCES - 1]);
    }
    for (int f = 0; f < FOURS; f++) total[f] += first / weighed * *weight++;
    for (int f = 0; f < FOURS; f++) total[f] += third / weighed * *weight++;
#endif
#endif
#ifdef COARSE_CHROMA
    // Add the change from the coarse chroma filter (l3cli/classes/coarse_chroma.py).
    const int row = row_source[y + RADIUS];
    for (int n = 0; n < 4; n++) {
        const size_t there = (size_t)(NEAREST(row) + MARGIN + n / 2) * BLOCKS_STRIDE(columns) + NEAREST(x) + MARGIN + n % 2;
        const size_t third = there + 2 * BLOCKS_PLANE(source_rows, columns);
        const float part = (n / 2 ? NEXT_SHARE(row) : 1.0f - NEXT_SHARE(row)) * (n % 2 ? NEXT_SHARE(x) : 1.0f - NEXT_SHARE(x));
        ((tap *)total)[CHROMA_1] += (after[there] - before[there]) * part * PLANE_STEP;
        ((tap *)total)[CHROMA_2] += (after[third] - before[third]) * part * PLANE_STEP;
    }
#endif
#ifdef CLIPPING
    // Replace outputs in uniform clipped areas, then change the hue in all clipped areas (l3cli/classes/clipping.py).
    __global const float *map = QUAD_MAPS(maps, row / 2, x / 2, columns);
    total[0].xyz = (1.0f - map[0]) * total[0].xyz + (float3)(map[1], map[2], map[3]);
    total[0].xz = (1.0f - map[4]) * total[0].xz + (float2)(map[5], map[6]) * total[0].y;
#endif
    tap output[4 * FOURS];
    for (int f = 0; f < FOURS; f++) {
        output[4 * f] = total[f].x;
        output[4 * f + 1] = total[f].y;
        output[4 * f + 2] = total[f].z;
        output[4 * f + 3] = total[f].w;
    }
#ifdef CORRECTS
    for (int o = 0; o < OUTPUTS; o++)
        output[o] += corrected[((size_t)o * source_rows + row_source[y + RADIUS]) * columns + x];
#endif
#if defined(WHITE_FROM) && !defined(FIXED_POINT)
    // Limit the luminance to that of the clipped white (l3cli/classes/clipping.py), which is stored after the matrix.
    const float limit = matrix[10], luminance_of_pixel = max(output[1], limit);
    const float faded = min((luminance_of_pixel - limit) / ((WHITE_FROM - 1.0f) * limit), 1.0f);
    for (int o = 0; o < 3; o++)
        output[o] = limit / luminance_of_pixel * (1.0f - faded) * output[o] + faded * matrix[9 + o];
#endif
#ifdef SHADED
    __global const float *node = gain + (size_t)y * GAIN_NODES(columns) + x / GAIN_STEP;
    const float factor = node[0] + (node[1] - node[0]) * ((x % GAIN_STEP) * (1.0f / GAIN_STEP));
    for (int o = 0; o < OUTPUTS; o++) output[o] *= factor;
#endif
    write(picture, output, matrix, at, (size_t)rows * columns);
}
