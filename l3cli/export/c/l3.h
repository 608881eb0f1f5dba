/* Raw mosaic -> classes -> outputs, by the transform table in l3_table.c. README.md says what the numbers mean.
 *
 * C99. No allocation, no globals that change, no library but <stddef.h> and <stdint.h>: all memory is the caller's, and any
 * number of threads may render at once, each in a workspace of its own. */
#ifndef L3_H
#define L3_H

#include <stddef.h>
#include <stdint.h>

#include "l3_table.h"

#ifdef __cplusplus
extern "C" {
#endif

#define L3_MOST_PIXELS 65535 /* rows, and columns, of a frame */

/* Bytes of the workspace that a frame needs; 0 if no frame of this size can be rendered. */
size_t l3_workspace_bytes(int rows, int columns);

/* Renders one frame. Returns 0, or -1 and writes nothing if a size or phase cannot be.
 *
 * raw        (row, column) DN, with the black level and white level of l3_table.h
 * phase_row, phase_column   CFA row and column of the first pixel
 * workspace  l3_workspace_bytes(rows, columns) bytes, aligned as malloc aligns; what it holds does not matter
 * labels     (layer, row, column): the class of each pixel in each of L3_LAYERS layers
 * outputs    (output, row, column): L3_OUTPUTS planes of L3Output, in steps of 2^-L3_OUTPUT_FRACTION */
int l3_render(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, void *workspace, uint32_t *labels,
              L3Output *outputs);

#ifdef __cplusplus
}
#endif

#endif
