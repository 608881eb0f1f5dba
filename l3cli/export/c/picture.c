/* Outputs -> sRGB. No library: a code is the number of thresholds that a linear value reaches, of which no bin holds two. */
#include "l3_picture.h"

#define STEP (1.0f / (float)(1 << L3_OUTPUT_FRACTION)) /* of an output */

#define BINS $bins

/* The least linear value that is shown by codes 1 ... 255, and one that none reaches. */
static const float threshold[256] = {
$thresholds
};

/* The code of the least value of each bin. */
static const uint8_t first_code[BINS] = {
$codes
};

const L3White l3_white = {
    {$gains},
    $luminance,
    {$matrix},
};

/* The nearest whole number, of two the even one. */
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

/* A number that orders as its float does. */
static uint32_t ordered(float value) {
    const union { float value; uint32_t bits; } same = {value};
    return same.bits & 0x80000000u ? ~same.bits : same.bits | 0x80000000u;
}

static float unordered(uint32_t order) {
    const union { uint32_t bits; float value; } same = {order & 0x80000000u ? order & 0x7fffffffu : ~order};
    return same.value;
}

#define DIGIT 11 /* bits of an order that a pass decides */

/* The value of `rank`, from 0, among `count`. */
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

float l3_auto_scale(const L3Output *outputs, int rows, int columns) {
    const ptrdiff_t count = (ptrdiff_t)rows * columns;
    const uint32_t last = (uint32_t)(count - 1), rest = last % 100 * 99, below = last / 100 * 99 + rest / 100;
    const float low = ranked(outputs + count, count, below), high = ranked(outputs + count, count, below < last ? below + 1 : last);
    const float bright = low + (high - low) * (float)(rest % 100) / 100;
    return bright > 0 ? 1 / bright : 1;
}

static uint8_t code_of(float linear) {
    if (!(linear > 0)) return 0;
    if (linear >= 1) return 255;
    const int code = first_code[(int)(linear * BINS)];
    return (uint8_t)(code + (linear >= threshold[code]));
}

void l3_picture(const L3Output *outputs, int rows, int columns, float scale, const L3White *white, uint8_t *picture) {
    const ptrdiff_t count = (ptrdiff_t)rows * columns;
    for (ptrdiff_t i = 0; i < count; i++) {
        const float x = (float)outputs[i] * STEP * scale, y = (float)outputs[count + i] * STEP * scale;
        const float z = (float)outputs[2 * count + i] * STEP * scale;
        for (int p = 0; p < 3; p++) {
            const float *row = white->matrix[p];
            picture[3 * i + p] = code_of(row[0] * x + row[1] * y + row[2] * z);
        }
    }
}
