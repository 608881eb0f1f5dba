/* Outputs of l3_render -> what `l3 render` shows: exposure, white, matrix and curve of sRGB, codes of 8 bits. l3_picture.c holds
 * the code and the white that the files were exported for. Computes in floats; without them leave both files out. */
#ifndef L3_PICTURE_H
#define L3_PICTURE_H

#include "l3.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A white of scenes, shown neutral. */
typedef struct {
    double gain[L3_CHANNELS]; /* of the channels, before l3_render; none below 1 */
    float luminance;          /* Y of a grey without the gains / with them: an exposure is multiplied by it */
    float matrix[3][3];       /* linear sRGB from X, Y, Z */
} L3White;

extern const L3White l3_white; /* README.md says of which white */

/* raw -> balanced (row, column), which may be raw: values times their channel's gain above `zero`, up to the white level. `zero`: black
 * level and mean dark signal of the frame, DN. Not needed where all gains are 1. */
void l3_balance(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, double zero, const L3White *white,
                uint16_t *balanced);

/* The scale that shows the 99th percentile of Y as white, less the noise of that percentile where pixels clip; 1 if all is dark. `raw`:
 * the values that l3_render read. */
float l3_auto_scale(const uint16_t *raw, const L3Output *outputs, int rows, int columns);

/* outputs (X Y Z, row, column) -> picture (row, column, red green blue), sRGB. `scale`: l3_auto_scale, or an exposure, which brings a Y of
 * 1 / exposure to white, times l3_white.luminance. */
void l3_picture(const L3Output *outputs, int rows, int columns, float scale, const L3White *white, uint8_t *picture);

#ifdef __cplusplus
}
#endif

#endif
