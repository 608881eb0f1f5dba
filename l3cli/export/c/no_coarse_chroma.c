
/* This table does not use coarse chroma. */
typedef struct {
    int nothing;
} CoarseChroma;

static CoarseChroma coarse_in(Room *room, int rows, int columns) {
    const CoarseChroma c = {0};
    (void)room, (void)rows, (void)columns;
    return c;
}

static void add_coarse_chroma(const CoarseChroma *c, const int32_t *planes, int rows, int columns, const L3Output *outputs) {
    (void)c, (void)planes, (void)rows, (void)columns, (void)outputs;
}
