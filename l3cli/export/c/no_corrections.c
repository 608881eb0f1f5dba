
/* The last layer of this table computes the outputs themselves, not corrections of the outputs of the first layer. */
static void add_first_outputs(const Ring *ring, size_t ring_values, const uint16_t *padded, int rows, int columns,
                              const uint32_t *labels, const L3Output *outputs) {
    (void)ring, (void)ring_values, (void)padded, (void)rows, (void)columns, (void)labels, (void)outputs;
}
