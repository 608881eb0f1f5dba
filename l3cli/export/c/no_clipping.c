
/* This table does not replace the outputs of uniform clipped areas. */
typedef struct {
    int nothing;
} Clipping;

static Clipping clipping_in(Room *room, int rows, int columns) {
    const Clipping c = {0};
    (void)room, (void)rows, (void)columns;
    return c;
}

static void replace_clipped(const Clipping *c, const uint16_t *padded, int rows, int columns, int phase_row, int phase_column,
                            const L3Output *outputs) {
    (void)c, (void)padded, (void)rows, (void)columns, (void)phase_row, (void)phase_column, (void)outputs;
}
