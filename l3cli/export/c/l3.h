/* Renders raw mosaics with the transform table in l3_table.c. README.md explains the inputs and outputs.
 *
 * The source is C99. It allocates no memory, has no mutable global variables, and includes only <stddef.h> and <stdint.h>. Several threads
 * can render at the same time if each has its own workspace. */
#ifndef L3_H
#define L3_H

#include <stddef.h>
#include <stdint.h>

#include "l3_table.h"

#ifdef __cplusplus
extern "C" {
#endif

#define L3_MOST_PIXELS 65535 /* maximum number of rows and maximum number of columns of a frame */

/* Returns the size of the workspace for a frame in bytes, or 0 if frames of this size cannot be rendered. */
size_t l3_workspace_bytes(int rows, int columns);

/* Renders one frame. Returns 0 on success. If the size or the phase is invalid, returns -1 and writes nothing.
 *
 * raw        (row, column) raw values in DN, with the black level and the white level of l3_table.h
 * phase_row, phase_column   CFA row and column of the first pixel
 * workspace  l3_workspace_bytes(rows, columns) bytes, aligned as by malloc; need not be initialised
 * labels     (layer, row, column) receives the class of each pixel in each of the L3_LAYERS layers
 * outputs    (output, row, column) receives L3_OUTPUTS planes, in steps of 2^-L3_OUTPUT_FRACTION of the output unit */
int l3_render(const uint16_t *raw, int rows, int columns, int phase_row, int phase_column, void *workspace, uint32_t *labels,
              L3Output *outputs);

#ifdef __cplusplus
}
#endif

#endif
