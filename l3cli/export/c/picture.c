/* Converts outputs to an 8-bit sRGB picture, without a mathematical library. The 8-bit value is the number of thresholds that a linear
 * value reaches. The search uses a table of bins. No bin contains more than one threshold. */
#include "l3_picture.h"

#define STEP (1.0f / (float)(1 << L3_OUTPUT_FRACTION)) /* step of an output */

#define NOISE $noise /* relative luminance error that noise can cause near clipped pixels */

#define BINS $bins

/* Lowest linear value of the 8-bit values 1 ... 255, followed by a threshold that no value reaches. */
static const float threshold[256] = {
$thresholds
};

/* 8-bit value at the lower end of each bin. */
static const uint8_t first_code[BINS] = {
$codes
};

const L3White l3_white = {
    {$gains},
    $luminance,
    {$matrix},
};

/* Rounds to the nearest integer. Halves are rounded to even integers. */
static uint16_t rounded(double value) {
    const uint16_t nearest = (uint16_t)(value + 0.5);
    return (uint16_t)(nearest - (nearest - value == 0.5 && nearest % 2 == 1));
}

void l3_balance(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, double zero, const L3White *white,
                uint16_t *balanced) {
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            const ptrdiff_t at = (ptrdiff_t)y * columns + x;
            const double gain = white->gain[l3_cfa[(y + phase_row) % L3_CFA_ROWS][(x + phase_column) % L3_CFA_COLUMNS]];
            const double value = raw[at], raised = (value - zero) * gain + zero, top = $top;
            const double limited = raised < 0 ? 0 : raised < top ? raised : top;
            balanced[at] = gain != 1 && value < (double)L3_WHITE_LEVEL ? rounded(limited) : raw[at];
        }
}

/* Converts a float to an integer, so that the integers have the same order as the floats. */
static uint32_t ordered(float value) {
    const union { float value; uint32_t bits; } same = {value};
    return same.bits & 0x80000000u ? ~same.bits : same.bits | 0x80000000u;
}

static float unordered(uint32_t order) {
    const union { uint32_t bits; float value; } same = {order & 0x80000000u ? order & 0x7fffffffu : ~order};
    return same.value;
}

#define DIGIT 11 /* number of bits that a pass determines */

/* Returns the value with the given rank, counted from 0, of `count` values. */
static float ranked(const L3Output *values, ptrdiff_t count, uint32_t rank) {
    uint32_t prefix = 0, decided = 0;
    for (int shift = 32 - DIGIT; decided != UINT32_MAX; shift = shift > DIGIT ? shift - DIGIT : 0) {
        uint32_t members[1 << DIGIT] = {0};
        uint32_t digit = 0;
        for (ptrdiff_t i = 0; i < count; i++) {
            const uint32_t order = ordered((float)values[i] * STEP);
            if ((order & decided) == prefix) members[order >> shift & ((1u << DIGIT) - 1)]++;
        }
        while (rank >= members[digit]) rank -= members[digit++];
        prefix |= digit << shift;
        decided |= UINT32_MAX << shift;
    }
    return unordered(prefix);
}

/* Whether a clipped pixel is near a pixel. */
static int near_clipped(const uint16_t *raw, int rows, int columns, int y, int x) {
    const int radius = L3_SATURATION_RADIUS;
    for (int r = y > radius ? y - radius : 0; r <= y + radius && r < rows; r++)
        for (int c = x > radius ? x - radius : 0; c <= x + radius && c < columns; c++)
            if (raw[(ptrdiff_t)r * columns + c] >= L3_SATURATION) return 1;
    return 0;
}

float l3_auto_scale(const uint16_t *raw, const L3Output *outputs, int rows, int columns) {
    const ptrdiff_t count = (ptrdiff_t)rows * columns;
    const L3Output *luminance = outputs + count;
    const uint32_t last = (uint32_t)(count - 1), rest = last % 100 * 99, below = last / 100 * 99 + rest / 100;
    const float low = ranked(luminance, count, below), high = ranked(luminance, count, below < last ? below + 1 : last);
    const float percentile = low + (high - low) * (float)(rest % 100) / 100;
    if (!(percentile > 0)) return 1;
    /* Near clipped pixels, fewer channels contribute to the luminance, and their noise raises the percentile. */
    double change = 0, alike = 0;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            const float value = (float)luminance[(ptrdiff_t)y * columns + x] * STEP, differs = value - percentile;
            if (differs > NOISE * percentile || differs < -NOISE * percentile) continue;
            change += near_clipped(raw, rows, columns, y, x) ? differs : 0;
            alike++;
        }
    return 1 / (percentile + (float)(change / (alike > 0 ? alike : 1)));
}

static uint8_t code_of(float linear) {
    if (!(linear > 0)) return 0;
    if (linear >= 1) return 255;
    const int code = first_code[(int)(linear * BINS)];
    return (uint8_t)(code + (linear >= threshold[code]));
}

/* Colours outside the sRGB gamut are moved into the gamut along lines of constant hue. l3cli/physics/gamut.py describes the method. */
static const float cones[3][3] = {$cones}; /* from linear sRGB to the cone responses of OkLab */
static const float back[3][3] = {$linear}; /* from cone responses to linear sRGB */
static const float lightness_of[3] = {$lightness};
static const float luminance_of[3] = {$y};

static float sum(const float row[3], const float value[3]) { return row[0] * value[0] + row[1] * value[1] + row[2] * value[2]; }

static float smaller(float a, float b) { return a < b ? a : b; }

static float larger(float a, float b) { return a > b ? a : b; }

/* Computes x^(1/3) for x > 0 with Newton's iteration for x^(-1/3). */
static float cube_root(float x) {
    union { float value; uint32_t bits; } y = {x};
    y.bits = UINT32_C(0x54a2fa8c) - y.bits / 3;
    for (int i = 0; i < 3; i++) y.value *= 4.0f / 3 - x / 3 * (y.value * y.value * y.value);
    return x * (y.value * y.value);
}

/* Reduces the chroma at constant lightness until no value is negative. */
static void less_chromatic(float linear[3]) {
    float chroma[3], squares[3], cubes[3], lowest = 0, least = 1;
    for (int c = 0; c < 3; c++) chroma[c] = sum(cones[c], linear);
    const float least_cone = larger(larger(larger(chroma[0], chroma[1]), chroma[2]) * $cone_share, $least_cone);
    for (int c = 0; c < 3; c++) chroma[c] = cube_root(larger(chroma[c], least_cone));
    const float lightness = larger(sum(lightness_of, chroma), $least_lightness), volume = lightness * lightness * lightness;
    for (int c = 0; c < 3; c++) {
        chroma[c] = chroma[c] / lightness - 1;
        squares[c] = chroma[c] * chroma[c];
        cubes[c] = squares[c] * chroma[c];
        lowest = smaller(lowest, linear[c] / volume);
    }
    const float t = 1 / (1 - lowest);
    for (int p = 0; p < 3; p++) {
        const float first = 3 * sum(back[p], chroma), second = 3 * sum(back[p], squares), third = sum(back[p], cubes);
        const float value = 1 + t * (first + t * (second + t * third));
        const float slope = first + t * (2 * second + t * (3 * third)), bend = 2 * second + t * (6 * third);
        const float square = slope * slope + $tiny;
        const float root = t - 2 * value * slope / larger(2 * square - value * bend, square);
        if (linear[p] < 0) least = smaller(least, root);
    }
    least = larger(least, 0);
    for (int c = 0; c < 3; c++) {
        const float root = 1 + least * chroma[c];
        cubes[c] = volume * (root * root * root);
    }
    for (int p = 0; p < 3; p++) linear[p] = sum(back[p], cubes);
}

/* Limits values to 1 by a mixture of darkening and clipping: the brighter the colour, the more clipping. */
static void darker(float linear[3], float most) {
    const float luminance = larger(smaller(sum(luminance_of, linear), 1), 0), square = luminance * luminance;
    for (int p = 0; p < 3; p++) {
        const float scaled = linear[p] / most;
        linear[p] = scaled + square * square * (smaller(linear[p], 1) - scaled);
    }
}

static void into_gamut(float linear[3]) {
    if (smaller(smaller(linear[0], linear[1]), linear[2]) < 0) less_chromatic(linear);
    const float most = larger(larger(linear[0], linear[1]), linear[2]);
    if (most > 1) darker(linear, most);
}

void l3_picture(const L3Output *outputs, int rows, int columns, float scale, const L3White *white, uint8_t *picture) {
    const ptrdiff_t count = (ptrdiff_t)rows * columns;
    for (ptrdiff_t i = 0; i < count; i++) {
        float xyz[3], linear[3];
        for (int o = 0; o < 3; o++) xyz[o] = (float)outputs[o * count + i] * STEP * scale;
        for (int p = 0; p < 3; p++) linear[p] = sum(white->matrix[p], xyz);
        into_gamut(linear);
        for (int p = 0; p < 3; p++) picture[3 * i + p] = code_of(linear[p]);
    }
}
