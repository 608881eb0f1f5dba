/* Converts the outputs of l3_render to an 8-bit sRGB picture like the picture of `l3 render`: exposure, white balance, matrix and sRGB
 * curve. l3_picture.c contains the code and the white for which the files were exported. It computes in floats. On processors without
 * floats, omit both files. */
#ifndef L3_PICTURE_H
#define L3_PICTURE_H

#include "l3.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Constants for a white that pictures show as neutral. */
typedef struct {
    double gain[L3_CHANNELS]; /* gains of the channels, applied before l3_render; at least 1 */
    float luminance;          /* Y of a grey without the gains, divided by its Y with the gains; multiply an exposure by this factor */
    float matrix[3][3];       /* from X, Y, Z to linear sRGB */
} L3White;

extern const L3White l3_white; /* white of the export, see README.md */

/* Multiplies the part of each raw value above `zero` by the gain of its channel, and limits the result to the white level. `zero` is the
 * black level plus the mean dark signal of the frame, in DN. `raw` and `balanced` are (row, column) and may be the same array. A call is
 * not needed if all gains are 1. */
void l3_balance(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, double zero, const L3White *white,
                uint16_t *balanced);

/* Returns the scale with which the 99th percentile of Y becomes white, or 1 if the frame is dark. Near clipped pixels, noise raises this
 * percentile, and the function corrects for it. `raw` contains the values that l3_render read. */
float l3_auto_scale(const uint16_t *raw, const L3Output *outputs, int rows, int columns);

/* Converts outputs (X Y Z, row, column) to an sRGB picture (row, column, red green blue). `scale` is the result of l3_auto_scale, or an
 * exposure times l3_white.luminance. With an exposure, a Y of 1 / exposure becomes white. */
void l3_picture(const L3Output *outputs, int rows, int columns, float scale, const L3White *white, uint8_t *picture);

#ifdef __cplusplus
}
#endif

#endif
