/* This table has no class features except level, contrast, saturation and chroma. */
static void find_combinations(const uint16_t *rows, ptrdiff_t span, const uint32_t *restrict level,
                              uint32_t *restrict combination) {
    (void)rows, (void)span, (void)level;
    for (int i = 0; i < L3_BLOCK; i++) combination[i] = 0;
}

