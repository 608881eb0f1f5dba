/* ------------------------------------------------------------------------------------------------- transforms to planes */

/* Every layer except the last computes three planes as 32-bit integers from 16-bit values and 16-bit weights. The classes of the next
 * layer are therefore the same on every processor.
 *
 * A transform is a dot product of consecutive values. The latest rows are therefore stored column by column. Let S be the number of
 * values per pixel (1 in the mosaic, 3 in planes) and P the side of the window. The values of padded row k and padded column p begin at
 * ring[(p * P + k) * S], and the patch of row y and column x begins at ring[(x * P + y) * S]. In the next row, every patch begins S
 * values later. The new values of column p overwrite the oldest values of column p + 1, which are no longer needed. The number of taps
 * is padded with zero weights to a multiple of 16. */

typedef struct {
    const int16_t *weights;   /* (class, plane, tap) */
    const int32_t *intercept; /* (class, plane) */
    const uint8_t *fraction;  /* (class) number of fractional bits */
} FixedPoint;

static inline int32_t to_plane(int32_t sum, int fraction) {
    return clamped((sum + (1 << fraction >> 1)) >> fraction, -L3_PLANE_TOP, L3_PLANE_TOP);
}

/* Computes one row of the planes. `step` is the distance between the patches of neighbouring columns in memory, and `pixels` the distance
 * between planes. */
static inline void fixed_point_row(const int16_t *restrict patches, ptrdiff_t step, int taps, const FixedPoint *fixed,
                                   const uint32_t *restrict labels, int columns, ptrdiff_t pixels, int32_t *restrict planes) {
    for (int x = 0; x < columns; x++) {
        const int16_t *restrict patch = patches + x * step;
        const int16_t *restrict weights = fixed->weights + (size_t)labels[x] * 3 * (size_t)taps;
        const int32_t *intercept = fixed->intercept + (size_t)labels[x] * 3;
        const int fraction = fixed->fraction[labels[x]];
        int32_t first = 0, second = 0, third = 0;
        for (int t = 0; t < taps; t++) {
            first += patch[t] * weights[t];
            second += patch[t] * weights[taps + t];
            third += patch[t] * weights[2 * taps + t];
        }
        planes[x] = to_plane(first + intercept[0], fraction);
        planes[pixels + x] = to_plane(second + intercept[1], fraction);
        planes[2 * pixels + x] = to_plane(third + intercept[2], fraction);
    }
}

/* Computes the planes (plane, row, column) of the first layer from the padded mosaic and the classes. */
static void mosaic_to_planes(const uint16_t *restrict padded, int16_t *restrict ring, size_t ring_values, int rows, int columns,
                             const uint32_t *restrict labels, int32_t *restrict planes) {
    static const FixedPoint fixed = {l3_weights, l3_intercept, l3_fraction};
    const ptrdiff_t span = padded_span(columns), pixels = (ptrdiff_t)rows * columns;
    for (size_t i = 0; i < ring_values; i++) ring[i] = 0;
    for (int k = 0; k < rows + DIAMETER; k++) {
        const uint16_t *restrict row = padded + k * span;
        for (int p = 0; p < columns + DIAMETER; p++) ring[(ptrdiff_t)p * L3_PATCH + k] = (int16_t)(row[p] - L3_RAW_MIDDLE);
        if (k < DIAMETER) continue;
        const ptrdiff_t at = (ptrdiff_t)(k - DIAMETER) * columns;
        fixed_point_row(ring + k - DIAMETER, L3_PATCH, L3_TAPS, &fixed, labels + at, columns, pixels, planes + at);
    }
}

/* Returns the column that replaces column `wanted` of a plane. */
static inline int mirrored_column(int wanted, int columns) {
    return wanted >= 0 && wanted < columns ? wanted : mirrored(wanted, columns, 1);
}

/* Reduces the resolution of a plane to 16 bits, for all layers except the last. */
static int16_t coarse(int32_t plane) {
    return (int16_t)clamped((plane + (1 << L3_COARSE >> 1)) >> L3_COARSE, -L3_COARSE_TOP, L3_COARSE_TOP);
}

/* Computes the planes for the next layer from the planes and the classes of a layer. */
static void planes_to_planes(const L3PlaneLayer *layer, const int32_t *restrict from, int16_t *restrict ring, size_t ring_values,
                             int rows, int columns, const uint32_t *restrict labels, int32_t *restrict planes) {
    const FixedPoint fixed = {layer->fixed_weights, layer->fixed_intercept, layer->fraction};
    const int radius = layer->side / 2;
    const ptrdiff_t step = 3 * layer->side, pixels = (ptrdiff_t)rows * columns;
    for (size_t i = 0; i < ring_values; i++) ring[i] = 0;
    for (int k = 0; k < rows + 2 * radius; k++) {
        const int32_t *restrict row = from + (ptrdiff_t)mirrored(k - radius, rows, 1) * columns;
        for (int p = 0; p < columns + 2 * radius; p++) {
            const int column = mirrored_column(p - radius, columns);
            for (int s = 0; s < 3; s++) ring[p * step + 3 * k + s] = coarse(row[s * pixels + column]);
        }
        if (k < 2 * radius) continue;
        const ptrdiff_t at = (ptrdiff_t)(k - 2 * radius) * columns;
        fixed_point_row(ring + 3 * (k - 2 * radius), step, layer->taps, &fixed, labels + at, columns, pixels, planes + at);
    }
}

/* ------------------------------------------------------------------------------------------------- transforms to outputs */

#if L3_RATIO_TAPS

/* Adds the rows of the window around a row. The result is (plane, padded column). */
static void sum_columns(const int32_t *restrict from, int radius, int row, int rows, int columns, int32_t *restrict sums) {
    const int span = columns + 2 * radius;
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns;
    for (int s = 0; s < 3; s++, from += pixels, sums += span) {
        int32_t *restrict inner = sums + radius;
        for (int c = 0; c < columns; c++) inner[c] = 0;
        for (int k = row - radius; k <= row + radius; k++) {
            const int32_t *restrict line = from + (ptrdiff_t)mirrored(k, rows, 1) * columns;
            for (int c = 0; c < columns; c++) inner[c] += line[c];
        }
        for (int p = 0; p < radius; p++) {
            sums[p] = inner[mirrored_column(p - radius, columns)];
            inner[columns + p] = inner[mirrored_column(columns + p, columns)];
        }
    }
}

/* Computes the colour-ratio taps of the pixel in column x from the sums over its window. `luminance` is the Y of the pixel. */
static inline void shaded_chroma(const int32_t *restrict sums, int side, int x, int columns, int32_t luminance,
                                 Chroma chroma[L3_RATIO_TAPS]) {
    const int span = columns + side - 1, count = side * side;
    int32_t sum[3] = {0, 0, 0};
    for (int s = 0; s < 3; s++)
        for (int p = x; p < x + side; p++) sum[s] += sums[s * span + p];
    const int32_t total = sum[L3_LUMINANCE], least = total > count * L3_RATIO_DARKEST ? total : count * L3_RATIO_DARKEST;
    const int64_t share = clamped(count * luminance - total, -least, least), whole = (int64_t)least * count;
    for (int i = 0; i < 2; i++) chroma[i] = quotient(sum[2 * i] * share, whole);
}

#if L3_RATIO_TAPS > 2

/* Computes the bilateral-chroma taps: the mean difference between the chroma of similar pixels in the window and the chroma of the pixel
 * itself. The likeness has 17 bits. The larger the likeness, the smaller the difference, so the sums of likeness^2 times difference fit
 * 64 bits. */
static void bilateral_change(const int32_t *restrict from, int side, int row, int x, int rows, int columns,
                             Chroma chroma[2]) {
    const ptrdiff_t pixels = (ptrdiff_t)rows * columns;
    int64_t square[L3_MOST_SIDE * L3_MOST_SIDE], reach = 0, weights = 0, change[2] = {0, 0};
    int32_t away[L3_MOST_SIDE * L3_MOST_SIDE][3];
    const int count = side * side;
    for (int n = 0; n < count; n++) {
        const ptrdiff_t line = mirrored(row + n / side - side / 2, rows, 1), column = mirrored_column(x + n % side - side / 2, columns);
        square[n] = 0;
        for (int s = 0; s < 3; s++) {
            away[n][s] = from[s * pixels + line * columns + column] - from[s * pixels + (ptrdiff_t)row * columns + x];
            square[n] += (int64_t)away[n][s] * away[n][s];
        }
        reach += square[n];
    }
    reach = reach / count + (int64_t)L3_RATIO_DARKEST * L3_RATIO_DARKEST;
    int shift = 0;
    while (reach >> shift >> 17) shift++;
    for (int n = 0; n < count; n++) {
        if (square[n] >= reach) continue;
        const int64_t likeness = (reach - square[n] + (1LL << shift >> 1)) >> shift, weight = likeness * likeness;
        weights += weight;
        for (int i = 0; i < 2; i++) change[i] += weight * away[n][2 * i];
    }
    for (int i = 0; i < 2; i++) chroma[i] = quotient(change[i], weights);
}

#endif

#endif

/* Computes the outputs (output, row, column) from the planes and the classes of the last layer. */
static void planes_to_outputs(const L3PlaneLayer *layer, const int32_t *restrict from, const Ring *ring, size_t ring_values,
                              int32_t *restrict sums, int rows, int columns, const uint32_t *restrict labels,
                              L3Output *restrict outputs) {
    const int radius = layer->side / 2;
    const ptrdiff_t step = 3 * layer->side, pixels = (ptrdiff_t)rows * columns;
    for (size_t i = 0; i < ring_values; i++) keep_nothing(ring, i);
    for (int k = 0; k < rows + 2 * radius; k++) {
        const int32_t *restrict row = from + (ptrdiff_t)mirrored(k - radius, rows, 1) * columns;
        for (int p = 0; p < columns + 2 * radius; p++) {
            const int column = mirrored_column(p - radius, columns);
            for (int s = 0; s < 3; s++) keep(ring, (size_t)(p * step + 3 * k + s), row[s * pixels + column]);
        }
        if (k < 2 * radius) continue;
        const ptrdiff_t at = (ptrdiff_t)(k - 2 * radius) * columns;
#if L3_RATIO_TAPS
        sum_columns(from, radius, k - 2 * radius, rows, columns, sums);
#else
        (void)sums;
#endif
        for (int x = 0; x < columns; x++) {
            const size_t first = (size_t)labels[at + x] * L3_OUTPUTS;
#if L3_RATIO_TAPS
            Chroma chroma[L3_RATIO_TAPS];
            shaded_chroma(sums, layer->side, x, columns, from[L3_LUMINANCE * pixels + at + x], chroma);
#if L3_RATIO_TAPS > 2
            bilateral_change(from, layer->side, k - 2 * radius, x, rows, columns, chroma + 2);
#endif
#define BEHIND(output) behind_of(chroma, output)
#else
#define BEHIND(output) 0
#endif
            for (size_t o = 0; o < L3_OUTPUTS; o++)
                outputs[(ptrdiff_t)o * pixels + at + x] =
                    output_of(ring, x * step + 3 * (k - 2 * radius), first + o, BEHIND(first + o));
        }
    }
}

